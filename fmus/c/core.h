/* What an FMU of this project is, apart from the FMI version it speaks.
 *
 * An FMU is a `System` of one or more parts, joined output to input and stepped together. A part is
 * a constant `Model` - tables and functions, nothing that changes - in a source file of its own
 * (part_NAME.c, and kernels_NAME.c where its kernels are apart); system.c names the parts and joins
 * them.
 *
 * What changes lies in one flat block of memory per instance, the `State`: saving it, restoring it
 * and writing it to a byte string are memcpy, exact to the bit. A `Part` holds the addresses of its
 * share of the block, and scratch memory; all of it is allocated when the instance is made.
 *
 * While stepping, a part sees what the others put out at the end of the last step (Jacobi): the
 * values on the connections are `carried` in the state. At initialization the parts are visited in
 * the order of their dependencies. Both give what a master makes of one FMU per part, to the bit.
 *
 * Arrays of numbers are those of LANES aircraft side by side, see kernel.h: of one, in an FMU. Times and numbers of
 * instants are those of all of them.
 */
#ifndef UAVTWIN_CORE_H
#define UAVTWIN_CORE_H

#include <stddef.h>
#include <stdint.h>

#include "kernel.h"

/* ---- what a part is: constant data ---- */
enum { PARAMETER, FIXED_PARAMETER, INPUT, OUTPUT, LOCAL }; /* from OUTPUT on: computed */
enum { REAL = 1, INTEGER = 2, BOOLEAN = 4, ENUMERATION = 8 }; /* what all hold as numbers */

typedef struct {
    const char* name;
    int causality, kind;
    double start, minimum, maximum;
    int may_lack; /* may be NaN */
} Variable;

typedef struct {
    const char* name;
    unsigned capacity; /* samples remembered, the present one among them */
} Line;

typedef struct Part Part;

/* What happens at the sample instants start + k period, k = first, first + 1, ... References are those
 * of the part. */
typedef struct {
    unsigned period, seed;
    unsigned first; /* 0, or 1: nothing is sampled at the start */
    unsigned n_noise;
    void (*sizes)(const Part* p, double* sizes); /* of the draws; one without size is left out */
    uint32_t stream; /* tells parts with one seed apart */
    unsigned n_lines;
    const Line* lines; /* delay lines */
    void (*signals)(const Part* p, double* now);    /* what enters the lines */
    void (*delays)(const Part* p, double* seconds); /* how far each is looked back */
    /* Change the states as the instant does, given standard normal draws and delayed signals. */
    void (*update)(Part* p, const double* noise, const double* delayed);
} Sampling;

/* A state that a solver outside integrates, in model exchange. References are those of the part. */
typedef struct {
    unsigned place; /* among all states of the part */
    unsigned reference, derivative;
    double nominal;
} Continuous;

typedef struct {
    unsigned n_variables, first_input, first_output; /* [0] is time; parameters, inputs, outputs */
    const Variable* variables;
    unsigned n_states;
    const char* const* state_names;
    double max_step;          /* s, longest internal step */
    const Sampling* sampling; /* NULL: none */
    /* Open what is needed from the resources folder; 0, or -1 with a message. NULL: nothing. */
    int (*open)(const char* resources, void** data, char* message, size_t size);
    void (*close)(void* data);
    /* What kernels need that depends on parameters alone; prepare = NULL: nothing. */
    unsigned n_prepared;
    void (*prepare)(const Part* p, double* prepared);
    void (*initial)(const Part* p, double* x);
    void (*step)(Part* p, double h); /* NULL: states change at instants alone */
    void (*outputs)(Part* p);
    /* Change of the outputs for small changes of parameters and inputs. `change` has one entry per
     * variable; those of parameters and inputs are read, those of outputs written. At the start the
     * states change too; `noise` is what the first sample instant draws. */
    void (*tangent)(const Part* p, int starting, const double* noise, double* change);
    /* For model exchange, a part alone; n_continuous = 0 and continuous = NULL: co-simulation only. */
    unsigned n_continuous;
    const Continuous* continuous;
    unsigned n_crossings;
    const unsigned* crossings; /* variables at whose zeros the derivatives jump */
    int (*rests)(const Part* p); /* whether nothing feels what is done at sample instants */
    int holds;  /* whether states and outputs change at sample instants alone, or with parameters */
    int passes; /* whether an output that nobody reads is an input and something held: of one instant */
} Model;

/* ---- how parts make a system: constant data, in system.c ---- */
typedef struct {
    unsigned part, variable; /* variable: value reference within the part */
    unsigned count;          /* of scalars from there on: 1, or the size of an array */
} Port;

typedef struct {
    Port source, target;
} Connection;

/* Connections are in the order of the parts where they end. */
typedef struct {
    const char* token;
    double step; /* s, longest step between two exchanges of values */
    unsigned n_parts;
    const Model* const* models;
    unsigned n_ports; /* variables of the FMU by value reference; [0] stands for time */
    const Port* ports;
    unsigned n_connections;
    const Connection* connections;
    unsigned n_visits; /* parts in the order in which outputs become right, some of them twice */
    const unsigned* visits;
} System;

extern const System fmu;

/* ---- an instance ---- */

/* Connections whose ends lie side by side in the state, and what of them is carried. */
typedef struct {
    const double* from;
    double *to, *carried;
    unsigned count;
} Wire;

struct Part {
    const Model* model;
    double *v, *x, *samples, *record;                 /* in the state: variables, states, sample
                                                         instants so far, delay lines */
    double *noise, *signal, *delayed, *change, *d_x;  /* scratch; changes are small, for tangents */
    double* prepared;                                 /* scratch, by `prepare` of these parameters */
    int ready;                                        /* whether it is that of the present ones */
    void* data;                                       /* made by open() */
    int gives;                                        /* whether a connection starts here */
    int rests;                                        /* whether the last step changed nothing */
    const Wire *wires, *end;                          /* to its inputs */
};

/* FAILED: a step broke off, and the states are no longer those of any one time. */
enum { INSTANTIATED, INITIALIZING, STEPPING, IN_EVENT, IN_TIME, TERMINATED, FAILED };
/* Which outputs are older than the states: none, those of parts that give nothing, or all. */
enum { FRESH, REST_STALE, STALE };

typedef struct {
    double time, start_time, stop_time; /* stop_time: HUGE_VAL where the importer defined none */
    int32_t mode, outputs;
    int32_t moved, unused; /* whether an event has moved a state that a solver integrates */
    double values[]; /* of the connections, then of the parts */
} State;

typedef struct {
    State* state;
    size_t state_size;
    double* carried; /* in the state, by connection */
    Wire* wires; /* part by part */
    void* host;      /* handles of the FMI shim, never part of the state */
    char exchange;   /* whether a solver outside integrates; else it is stepped */
    char message[320];
    Part parts[];
} Instance;

/* ---- used by the FMI shims: 0, or -1 with c->message ---- */
Instance* core_new(const char* resources, int exchange, char* message, size_t size);
void core_free(Instance* c);
void core_reset(Instance* c);
size_t core_size(const unsigned vr[], size_t n); /* values of these variables together */
/* Element i of a variable, 0 of a scalar, of one of these kinds; of each lane. */
int core_get(Instance* c, unsigned vr, size_t i, int kinds, double value[]);
int core_set(Instance* c, unsigned vr, size_t i, int kinds, const double value[]);
int core_set_times(Instance* c, double start_time, double stop_time);
int core_enter_initialization(Instance* c);
int core_exit_initialization(Instance* c);
int core_derivative(Instance* c, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                    size_t n_known, const double seed[], double result[]);
int core_step(Instance* c, double time, double h);
int core_terminate(Instance* c);

/* Model exchange. The order of states and crossings is that of the tables. */
int core_can_exchange(void);
int core_enter_event(Instance* c);
int core_enter_time(Instance* c);
int core_set_time(Instance* c, double time);
int core_completed_step(Instance* c);
int core_evaluate(Instance* c);
/* An iteration of an event; *next is HUGE_VAL where no instant is to come. */
int core_update(Instance* c, int* states_moved, double* next);
int core_get_states(Instance* c, double x[], size_t n);
int core_set_states(Instance* c, const double x[], size_t n);
int core_get_derivatives(Instance* c, double dx[], size_t n);
int core_get_nominals(Instance* c, double x[], size_t n);
int core_get_crossings(Instance* c, double z[], size_t n);

/* A saved state: version tag and bytes, core_saved_size() in all. */
size_t core_saved_size(const Instance* c);
void core_save(const Instance* c, char* bytes);
int core_check_saved(Instance* c, const char* bytes, size_t size);
int core_restore(Instance* c, const char* bytes, size_t size);

#endif
