/* What an FMU of this project is, apart from the FMI version it speaks.
 *
 * An instance is one flat `State`: saving it, restoring it and writing it to a byte string are
 * memcpy, exact to the bit. A model (generated `model.c`, or `replay.c`) supplies the table of
 * variables and three functions of the state.
 */
#ifndef UAVTWIN_CORE_H
#define UAVTWIN_CORE_H

#include <stddef.h>
#include "model.h" /* N_VARIABLES, FIRST_INPUT, FIRST_OUTPUT, N_STATES, MAX_STEP, MODEL_TOKEN; for a
                      sampled model also SAMPLE_PERIOD and SEED (value references), N_NOISE, STREAM */

enum { PARAMETER, FIXED_PARAMETER, INPUT, OUTPUT };

typedef struct {
    const char* name;
    const char* unit;
    int causality;
    int boolean;
    double start, minimum, maximum;
} Variable;

enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };

/* v[0] is time; v[value reference] the variables in the order parameters, inputs, outputs. */
typedef struct {
    double v[N_VARIABLES];
    double x[N_STATES + 1];
    double start_time;
    double samples; /* sample instants since the start */
    int mode;
    int outputs_stale;
} State;

/* ---- supplied by the model ---- */
extern const Variable variables[N_VARIABLES];
extern const char* const state_names[N_STATES + 1];
/* Open what the model needs from the resources folder; 0, or -1 with a message. */
int model_open(const char* resources, void** data, char* message, size_t size);
void model_close(void* data);
void model_initial(const State* s, const void* data, double* x);
void model_step(const State* s, const void* data, double h, double* x_next);
void model_outputs(State* s, void* data);
/* State after a sample instant, given N_NOISE standard normal draws. */
void model_update(const State* s, const void* data, const double* noise, double* x_next);
/* Change of the outputs for small changes of parameters and inputs. `change` has one entry per
 * variable; the entries of parameters and inputs are read, those of outputs written. At the end of
 * initialization the initial states change too. */
void model_tangent(const State* s, const void* data, int initializing, double* change);

/* ---- used by the FMI shims ---- */
typedef struct {
    State state;
    void* data;
    void* host; /* handles of the FMI shim, never part of the state */
    char message[320];
} Instance;

Instance* core_new(const char* resources, char* message, size_t size);
void core_free(Instance* c);
void core_reset(Instance* c);
int core_get(Instance* c, unsigned vr, double* value);
int core_set(Instance* c, unsigned vr, double value);
int core_enter_initialization(Instance* c, double start_time);
int core_exit_initialization(Instance* c);
int core_derivative(Instance* c, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                    size_t n_known, const double seed[], double result[]);
int core_step(Instance* c, double time, double h);
int core_terminate(Instance* c);

/* A saved state: version tag, size and bytes. */
size_t core_saved_size(void);
void core_save(const Instance* c, char* bytes);
int core_restore(Instance* c, const char* bytes, size_t size);

#endif
