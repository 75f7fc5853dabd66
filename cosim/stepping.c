/* Communication steps of a system whose FMUs are loaded in this process; `compiled.py` makes the table of calls. */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

enum { SET, GET, STEP };
enum { FINISHED, NOT_FINITE = -1 };

typedef struct {
    int32_t verb, fmi, type;     /* of the buffer: see `move` */
    int64_t number;              /* of the call, in the trace */
    void (*function)(void);
    void* instance;
    const uint32_t* references;
    size_t count;
    void* buffer;
    double* values;              /* of the bus */
    const int64_t* positions;    /* of the buffer's entries in `values`; null: the buffer is there already */
    double *time, *length, *reached;
    uint8_t* flags;              /* event, termination, early return */
} Call;

typedef struct {
    const Call* calls;
    int64_t n_calls;
    double origin, step, stop;
    int64_t done, last, every;   /* steps: taken, to take, between two rows */
    double* values;
    int64_t n_values;
    const int64_t* columns;
    int64_t n_columns;
    double *times, *rows;
    volatile int64_t* trace;     /* number of the present call; null: none */
    double patience;             /* s */
    volatile int32_t interrupted;
    int32_t status, spoilt;      /* of the failed call */
} Run;

typedef int (*Transfer2)(void*, const uint32_t*, size_t, void*);
typedef int (*Transfer3)(void*, const uint32_t*, size_t, void*, size_t);
typedef int (*Step2)(void*, double, double, int);
typedef int (*Step3)(void*, double, double, bool, uint8_t*, uint8_t*, uint8_t*, double*);

static volatile const double one = 1.0, quarter = 0x1p-54, more = 0x1.8p-53, following = 0x1.0000000000001p0,
                             tiny = 0x1p-1074;

/* Rounds to nearest and keeps subnormal numbers. */
static bool sound(void) { return one + quarter + more == following && tiny + tiny != 0.0; }

#define MOVE(code, type)                                                                     \
    case code:                                                                               \
        for (size_t i = 0; i < c->count; i++) {                                              \
            if (c->verb == SET)                                                              \
                ((type*)c->buffer)[i] = (type)c->values[c->positions[i]];                    \
            else                                                                             \
                c->values[c->positions[i]] = (double)((type*)c->buffer)[i];                  \
        }                                                                                    \
        break;

/* Values of the bus to the buffer of a call, or back. */
static void move(const Call* c) {
    if (!c->positions) return;
    switch (c->type) {
        MOVE(0, double)
        MOVE(1, float)
        MOVE(2, int8_t)
        MOVE(3, uint8_t)
        MOVE(4, int16_t)
        MOVE(5, uint16_t)
        MOVE(6, int32_t)
        MOVE(7, uint32_t)
        MOVE(8, int64_t)
        MOVE(9, uint64_t)
        MOVE(10, bool)
    }
}

static int make(const Call* c, double time, double length) {
    if (c->verb != STEP) {
        if (c->fmi == 2) return ((Transfer2)c->function)(c->instance, c->references, c->count, c->buffer);
        return ((Transfer3)c->function)(c->instance, c->references, c->count, c->buffer, c->count);
    }
    *c->time = time;
    *c->length = length;
    if (c->fmi == 2) return ((Step2)c->function)(c->instance, time, length, 0);
    return ((Step3)c->function)(c->instance, time, length, false, c->flags, c->flags + 1, c->flags + 2, c->reached);
}

/* Make a call; whether it failed. Warnings are none. */
static bool fails(const Call* c, Run* r, double time, double length) {
    if (c->verb == SET) move(c);
    if (r->trace) *r->trace = c->number;
    r->status = make(c, time, length);
    if (r->trace) *r->trace = -c->number;
    const bool flagged = c->verb == STEP && (c->flags[0] || c->flags[1] || c->flags[2]);
    r->spoilt = r->trace && !sound();
    if (r->spoilt || flagged || r->status < 0 || r->status > 1) return true;
    if (c->verb == GET) move(c);
    return false;
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Steps until the last one or out of patience: FINISHED, NOT_FINITE, or 1 + the index of the call that failed. */
__attribute__((visibility("default"))) int64_t take_steps(Run* r) {
    const double end = now() + r->patience;
    while (r->done < r->last && !r->interrupted) {
        const double time = r->origin + (double)r->done * r->step;
        const double left = r->stop - time, length = left < r->step ? left : r->step;
        for (int64_t i = 0; i < r->n_calls; i++) {
            if (fails(&r->calls[i], r, time, length)) return 1 + i;
        }
        const double reached = r->origin + (double)(r->done + 1) * r->step;
        bool finite = true;
        for (int64_t i = 0; i < r->n_values; i++) finite &= fabs(r->values[i]) < HUGE_VAL;
        if (!finite) return NOT_FINITE;
        if ((r->done + 1) % r->every == 0) {
            const int64_t row = (r->done + 1) / r->every;
            double* to = r->rows + row * r->n_columns;
            for (int64_t i = 0; i < r->n_columns; i++) to[i] = r->values[r->columns[i]];
            __atomic_signal_fence(__ATOMIC_SEQ_CST); /* the time marks the row as complete */
            r->times[row] = reached;
        }
        r->done++;
        if (now() > end) break;
    }
    return FINISHED;
}
