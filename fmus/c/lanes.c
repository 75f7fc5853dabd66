/* Several aircraft flown at once by the sources of their FMU, compiled for LANES of them. */
#include <math.h>
#include <stdio.h>

#include "core.h"

#define ANY (REAL | INTEGER | BOOLEAN | ENUMERATION)
#define PUBLIC __attribute__((visibility("default")))

/* Fly LANES aircraft from a start time on, each with start values of its own.
 *
 * `values` are those of the `n_set` variables `set`, of one variable lane by lane; NaN: the model's own. At the start
 * and after every `every`-th of `n_steps` steps the `n_read` outputs `read` make a row of `rows`, of one output lane by
 * lane: n_steps / every + 1 rows, and room for one more. 0; or -1 with why, where one of them does not come to its end,
 * and then nothing is said of any. */
PUBLIC int lanes_fly(double start_time, unsigned n_set, const unsigned set[], const double values[], double step,
                     long n_steps, long every, unsigned n_read, const unsigned read[], double rows[], char* message,
                     size_t size) {
    Instance* c = core_new("", 0, message, size);
    if (!c) return -1;
    int failed = core_set_times(c, start_time, HUGE_VAL);
    for (unsigned i = 0; !failed && i < n_set; i++) {
        const Port at = fmu.ports[set[i]];
        double value[LANES];
        const double own = fmu.models[at.part]->variables[at.variable].start;
        FOR_LANES value[lane] = isnan(values[AT(i)]) ? own : values[AT(i)];
        failed = core_set(c, set[i], 0, ANY, value);
    }
    failed = failed || core_enter_initialization(c) || core_exit_initialization(c);
    for (long k = 0; !failed; k++) {
        for (unsigned i = 0; !failed && i < n_read; i++) {
            failed = core_get(c, read[i], 0, ANY, rows + i * LANES);
            FOR_LANES failed = failed || !isfinite(rows[AT(i)]);
        }
        if (k == n_steps) break;
        if (k % every == 0) rows += n_read * LANES;
        failed = failed || core_step(c, start_time + k * step, step);
    }
    snprintf(message, size, "%s", c->message);
    core_free(c);
    return failed ? -1 : 0;
}
