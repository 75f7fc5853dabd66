#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "noise.h"

/* As in the Python reference, twin/component.py. */
#define SAMPLE_TOLERANCE 1e-6

#define FOR_EACH_PART(P) for (Part* P = c->parts; P < c->parts + fmu.n_parts; P++)

static int fail(Instance* c, const char* format, const char* name, double a, double b) {
    snprintf(c->message, sizeof c->message, format, name, a, b);
    return -1;
}

/* ---- memory ---- */

static size_t record_size(const Model* m) {
    size_t n = 0;
    for (unsigned i = 0; m->sampling && i < m->sampling->n_lines; i++) n += m->sampling->lines[i].capacity;
    return n;
}

/* n numbers of each lane. */
static double* take(double** from, size_t n) {
    double* taken = *from;
    *from += n * LANES;
    return taken;
}

/* One block: the state, then scratch. Those of several lanes begin where the longest register may. */
static int allocate(Instance* c) {
    enum { REGISTER = LANES > 1 ? 8 : 1 }; /* numbers */
    size_t kept = fmu.n_connections, scratch = 0;
    FOR_EACH_PART(p) {
        const Model* m = p->model;
        const Sampling* s = m->sampling;
        kept += m->n_variables + m->n_states + 1 + record_size(m);
        scratch += m->n_variables + m->n_states + m->n_prepared + (s ? s->n_noise + 2 * s->n_lines : 0);
    }
    c->state_size = sizeof(State) + kept * LANES * sizeof(double);
    c->state = calloc(1, c->state_size + (scratch * LANES + REGISTER - 1) * sizeof(double));
    c->wires = calloc(fmu.n_connections + 1, sizeof *c->wires);
    if (!c->state || !c->wires) return -1;
    double* state = c->state->values;
    while ((uintptr_t)state % (REGISTER * sizeof(double))) state++;
    double* rest = state + kept * LANES;
    c->carried = take(&state, fmu.n_connections);
    FOR_EACH_PART(p) {
        const Model* m = p->model;
        const Sampling* s = m->sampling;
        p->v = take(&state, m->n_variables);
        p->x = take(&state, m->n_states);
        p->samples = take(&state, 1);
        p->record = take(&state, record_size(m));
        p->change = take(&rest, m->n_variables);
        p->d_x = take(&rest, m->n_states);
        p->prepared = take(&rest, m->n_prepared);
        p->noise = take(&rest, s ? s->n_noise : 0);
        p->signal = take(&rest, s ? s->n_lines : 0);
        p->delayed = take(&rest, s ? s->n_lines : 0);
    }
    return 0;
}

/* The connections to each part, those that lie side by side as one wire. */
static void lay_wires(Instance* c) {
    Wire* next = c->wires;
    unsigned i = 0;
    FOR_EACH_PART(p) {
        p->wires = next;
        for (; i < fmu.n_connections && &c->parts[fmu.connections[i].target.part] == p; i++) {
            const Port source = fmu.connections[i].source;
            const double* from = c->parts[source.part].v + LANES * source.variable;
            double* to = p->v + LANES * fmu.connections[i].target.variable;
            if (next > p->wires && from == next[-1].from + next[-1].count && to == next[-1].to + next[-1].count)
                next[-1].count += LANES;
            else *next++ = (Wire){from, to, c->carried + LANES * i, LANES};
            c->parts[source.part].gives = 1;
        }
        p->end = next;
    }
}

Instance* core_new(const char* resources, int exchange, char* message, size_t size) {
    Instance* c = calloc(1, sizeof *c + fmu.n_parts * sizeof(Part));
    for (unsigned i = 0; c && i < fmu.n_parts; i++) c->parts[i].model = fmu.models[i];
    if (!c || allocate(c)) {
        snprintf(message, size, "out of memory");
        if (c) free(c->state);
        free(c);
        return NULL;
    }
    lay_wires(c);
    FOR_EACH_PART(p) {
        if (p->model->open && p->model->open(resources, &p->data, message, size)) {
            core_free(c);
            return NULL;
        }
    }
    c->exchange = exchange != 0;
    core_reset(c);
    return c;
}

void core_free(Instance* c) {
    if (!c) return;
    FOR_EACH_PART(p)
        if (p->data) p->model->close(p->data);
    free(c->wires);
    free(c->state);
    free(c);
}

void core_reset(Instance* c) {
    memset(c->state, 0, c->state_size);
    FOR_EACH_PART(p) {
        for (unsigned i = 1; i < p->model->first_output; i++)
            FOR_LANES p->v[AT(i)] = p->model->variables[i].start;
        p->ready = 0;
    }
    c->state->stop_time = HUGE_VAL;
    c->state->mode = INSTANTIATED;
    c->state->outputs = STALE;
}

/* ---- one part ---- */

/* What depends on parameters alone, computed again if one has changed. Before any kernel of a step. */
static void prepare(Part* p) {
    if (p->ready) return;
    if (p->model->prepare) p->model->prepare(p, p->prepared);
    p->ready = 1;
}

/* Whether none of n numbers is infinite or NaN: the exponent of those is all ones, so that one more
 * carries into the place of the sign. */
static int all_finite(const double* values, unsigned n) {
    const uint64_t rest = 0x7fffffffffffffffu, one = 0x0010000000000000u;
    uint64_t carry = 0, bits;
    for (unsigned i = 0; i < n; i++) {
        memcpy(&bits, values + i, sizeof bits);
        carry |= (bits & rest) + one;
    }
    return !(carry >> 63);
}

static int check_states(Instance* c, const Part* p) {
    if (all_finite(p->x, p->model->n_states * LANES)) return 0;
    for (unsigned i = 0; i < p->model->n_states * LANES; i++)
        if (!isfinite(p->x[i]))
            return fail(c, "state %s = %g at time %g s: the simulation has diverged",
                        p->model->state_names[i / LANES], p->x[i], p->v[0]);
    return 0;
}

static int put_out(Instance* c, Part* p) {
    const Model* m = p->model;
    prepare(p);
    m->outputs(p);
    if (all_finite(p->v + m->first_output * LANES, (m->n_variables - m->first_output) * LANES)) return 0;
    for (unsigned i = m->first_output * LANES; i < m->n_variables * LANES; i++)
        if (!isfinite(p->v[i]) && !(m->variables[i / LANES].may_lack && isnan(p->v[i])))
            return fail(c, "output %s = %g at time %g s is not a finite number", m->variables[i / LANES].name,
                        p->v[i], p->v[0]);
    return 0;
}

/* Where in a line of n the sample lies that is so far back from sample k, which is at `at`. */
static unsigned place_of(unsigned back, uint64_t k, unsigned at, unsigned n) {
    return back < k ? (back <= at ? at - back : at + n - back) : 0;
}

/* Remember the signals of sample instant k, and look each up at its delay before, between two
 * instants on a straight line. Sample j of a line is at j modulo capacity; before the first sample
 * a signal counts as having always had that value. */
static int look_back(Instance* c, Part* p) {
    const Sampling* s = p->model->sampling;
    const uint64_t k = (uint64_t)*p->samples;
    const double period = p->v[LANES * s->period];
    double* line = p->record;
    s->signals(p, p->signal);
    s->delays(p, p->delayed);
    unsigned n = 0, at = 0; /* capacity of a line, and where its present sample goes */
    double delay[LANES] = {0}, share[LANES] = {0}; /* those of the line before: one sensor's have mostly the same */
    unsigned late[LANES] = {0}, later[LANES] = {0}; /* where the samples are between which the delay ends */
    for (unsigned i = 0; i < s->n_lines; line += n * LANES, i++) {
        const int other = s->lines[i].capacity != n;
        if (other) n = s->lines[i].capacity, at = (unsigned)(k % n);
        int same = !other;
        EACH_LANE same &= p->delayed[AT(i)] == delay[lane];
        if (!same) FOR_LANES {
            delay[lane] = p->delayed[AT(i)];
            double periods = delay[lane] / period;
            if (!(periods >= 0 && periods <= n - 1 + SAMPLE_TOLERANCE))
                return fail(c,
                            "delay %s = %g s must be from 0 to %g s: make it shorter or sample_period longer",
                            s->lines[i].name, delay[lane], (n - 1) * period);
            if (periods > n - 1) periods = n - 1;
            const unsigned back = (unsigned)periods;
            share[lane] = periods - back;
            late[lane] = place_of(back, k, at, n);
            later[lane] = place_of(back + 1, k, at, n);
        }
        EACH_LANE {
            line[AT(at)] = p->signal[AT(i)];
            const double after = line[AT(late[lane])], before = line[AT(later[lane])];
            p->delayed[AT(i)] = after + share[lane] * (before - after);
        }
    }
    return 0;
}

static int sample(Instance* c, Part* p) {
    const Sampling* s = p->model->sampling;
    if (s->n_lines && look_back(c, p)) return -1;
    if (s->n_noise) {
        s->sizes(p, p->noise);
        standard_normal(p->v + LANES * s->seed, s->stream, (int)s->n_noise, (uint64_t)*p->samples, p->noise);
    }
    s->update(p, p->noise, p->delayed);
    return 0;
}

/* States at the start, a sample instant there included. */
static int begin(Instance* c, Part* p) {
    const Sampling* s = p->model->sampling;
    prepare(p);
    p->model->initial(p, p->x);
    *p->samples = 0;
    for (int lane = 1; s && lane < LANES; lane++)
        if (p->v[AT(s->period)] != p->v[LANES * s->period])
            return fail(c, "%sone lane samples every %g s, another every %g s", "", p->v[LANES * s->period],
                        p->v[AT(s->period)]);
    return s && s->first == 0 ? sample(c, p) : 0;
}

/* Integrate over a time without sample instants, in equal parts of at most max_step. */
static void integrate(Part* p, double h) {
    const Model* m = p->model;
    if (!m->step || m->n_states == 0) return;
    double n = h <= m->max_step ? 1 : ceil(h / m->max_step - 1e-6);
    if (n < 1) n = 1;
    const double dt = n == 1 ? h : h / n;
    for (long k = 0; k < (long)n; k++) m->step(p, dt);
}

/* Whether a step changes nothing but the time: what changes at instants alone, with none due. */
static int rests(const Instance* c, const Part* p, double time, double h) {
    if (!p->model->holds || !p->ready) return 0;
    const double period = p->v[LANES * p->model->sampling->period];
    return c->state->start_time + (*p->samples + 1) * period - time > h + SAMPLE_TOLERANCE * period;
}

static int advance(Instance* c, Part* p, double time, double h) {
    const Sampling* s = p->model->sampling;
    const double samples = *p->samples;
    prepare(p);
    if (!s) {
        integrate(p, h);
    } else {
        const double period = p->v[LANES * s->period], slack = SAMPLE_TOLERANCE * period;
        double now = time, left = h;
        for (;;) {
            double ahead = c->state->start_time + (*p->samples + 1) * period - now;
            int due = ahead <= left + slack;
            double part = due && ahead < left - slack ? ahead : left;
            if (part > slack) integrate(p, part);
            now += part;
            left -= part;
            if (!due) break;
            *p->samples += 1;
            if (sample(c, p)) return -1;
        }
    }
    FOR_LANES p->v[lane] = time + h;
    const int unchanged = !p->model->step && *p->samples == samples;
    return unchanged ? 0 : check_states(c, p);
}

/* ---- parts together ---- */

#define FOR_EACH_WIRE(W, P) for (const Wire* W = (P)->wires; W < (P)->end; W++)

/* What is carried reaches the inputs of a part, or at once what the others have put out. */
static void receive(Part* p, int carried) {
    FOR_EACH_WIRE(w, p) {
        const double* from = carried ? w->carried : w->from;
        memcpy(w->to, from, w->count * sizeof *from);
    }
}

/* What the parts have put out is carried. */
static void give(Instance* c) {
    FOR_EACH_PART(p) FOR_EACH_WIRE(w, p)
        memcpy(w->carried, w->from, w->count * sizeof *w->from);
}

/* Everything at the start, as start values and free inputs have it: the parts are visited in the
 * order of their dependencies; each gets its connected inputs, finds its states, and puts out. With
 * `tangents` small changes go the same way. */
static int settle(Instance* c, int tangents) {
    for (unsigned i = 0; i < fmu.n_connections; i++) {
        const Port to = fmu.connections[i].target;
        FOR_LANES c->carried[AT(i)] = fmu.models[to.part]->variables[to.variable].start;
    }
    for (unsigned k = 0; k < fmu.n_visits; k++) {
        Part* p = &c->parts[fmu.visits[k]];
        receive(p, 1);
        if (begin(c, p) || put_out(c, p)) return -1;
        if (tangents) p->model->tangent(p, 1, p->noise, p->change);
        for (unsigned i = 0; i < fmu.n_connections; i++) {
            const Port from = fmu.connections[i].source, to = fmu.connections[i].target;
            if (from.part != fmu.visits[k]) continue;
            FOR_LANES {
                c->carried[AT(i)] = p->v[AT(from.variable)];
                c->parts[to.part].change[AT(to.variable)] = p->change[AT(from.variable)];
            }
        }
    }
    return 0;
}

static int refresh(Instance* c) {
    if (c->state->outputs == FRESH) return 0;
    if (c->state->mode < STEPPING) {
        if (settle(c, 0)) return -1;
    } else {
        FOR_EACH_PART(p) {
            if (p->gives && c->state->outputs == REST_STALE) continue;
            if (p->model->passes && !p->gives) receive(p, 0); /* of this instant; what it holds is of the last */
            if (put_out(c, p)) return -1;
        }
    }
    c->state->outputs = FRESH;
    return 0;
}

/* All parts step from their inputs, carried or as just put out, then those that give put out; what
 * no part reads waits until somebody asks. Outputs change after the last step alone. */
static int step_all(Instance* c, double time, double h, int carried) {
    FOR_EACH_PART(p) {
        p->rests = rests(c, p, time, h);
        if (p->rests) continue;
        receive(p, carried);
        if (advance(c, p, time, h)) return -1;
    }
    c->state->outputs = STALE;
    FOR_EACH_PART(p)
        if (p->gives && !p->rests && put_out(c, p)) return -1;
    return 0;
}

/* A time that rounding alone keeps off the grid start + k step, put on it: what comes out does not
 * depend on how the importer divides the time. */
static double on_grid(const Instance* c, double time) {
    const double start = c->state->start_time, grid = start + round((time - start) / fmu.step) * fmu.step;
    return fabs(grid - time) <= 1e-6 * fmu.step ? grid : time;
}

/* n steps, the values handed on between them; those after the last are carried, since outputs that
 * somebody asks for feel the inputs held until then. */
static int step_often(Instance* c, double time, double h, long n) {
    for (long k = 0; k < n; k++)
        if (step_all(c, n > 1 ? on_grid(c, time + k * h) : time, h, k == 0)) return -1;
    give(c);
    if (fmu.n_connections) c->state->outputs = REST_STALE;
    return 0;
}

/* ---- states of the FMI calling sequence ---- */

static int check_mode(Instance* c, int from, int to, const char* what, const char* done) {
    static const char* const names[] = {
        "before initialization", "in initialization mode", "in step mode",   "in event mode",
        "in continuous-time mode", "after terminate",       "after an error in a step"};
    const int mode = c->state->mode;
    if (mode >= from && mode <= to) return 0;
    snprintf(c->message, sizeof c->message, "%s cannot be %s %s%s", what, done, names[mode],
             mode >= TERMINATED ? "; reset the FMU first" : "");
    return -1;
}

/* ---- variables ---- */

static int check_kind(Instance* c, const Variable* k, int kinds) {
    if (k->kind & kinds) return 0;
    const char* name = k->kind == REAL      ? "a real number"
                       : k->kind == INTEGER ? "an integer"
                       : k->kind == BOOLEAN ? "a truth value"
                                            : "an enumeration";
    snprintf(c->message, sizeof c->message, "%s is %s: get and set it by the functions of that type", k->name,
             name);
    return -1;
}

size_t core_size(const unsigned vr[], size_t n) {
    size_t size = 0;
    for (size_t i = 0; i < n; i++) size += vr[i] < fmu.n_ports ? fmu.ports[vr[i]].count : 1;
    return size;
}

int core_get(Instance* c, unsigned vr, size_t i, int kinds, double value[]) {
    if (vr >= fmu.n_ports) return fail(c, "%sno variable has value reference %.0f", "", vr, 0);
    Port at = fmu.ports[vr];
    at.variable += (unsigned)i;
    const Variable* k = &fmu.models[at.part]->variables[at.variable];
    if (check_kind(c, k, kinds) || check_mode(c, INITIALIZING, FAILED, k->name, "read")) return -1;
    if (vr == 0) {
        FOR_LANES value[lane] = c->state->time;
        return 0;
    }
    if (at.variable >= fmu.models[at.part]->first_output && refresh(c)) return -1;
    FOR_LANES {
        value[lane] = c->parts[at.part].v[AT(at.variable)];
        if (k->kind != REAL && !(fabs(value[lane]) <= INT32_MAX))
            return fail(c, "%s = %g at time %g s does not fit into 32 bits", k->name, value[lane], c->state->time);
    }
    return 0;
}

int core_set(Instance* c, unsigned vr, size_t i, int kinds, const double value[]) {
    if (vr == 0 || vr >= fmu.n_ports)
        return fail(c, "%sno settable variable has value reference %.0f", "", vr, 0);
    Port at = fmu.ports[vr];
    at.variable += (unsigned)i;
    const Variable* k = &fmu.models[at.part]->variables[at.variable];
    if (check_kind(c, k, kinds) || check_mode(c, INSTANTIATED, IN_TIME, k->name, "set")) return -1;
    if (k->causality >= OUTPUT) return fail(c, "%s is computed and cannot be set", k->name, 0, 0);
    if (k->causality == FIXED_PARAMETER && c->state->mode >= STEPPING)
        return fail(c, "%s is fixed once initialization has ended; reset the FMU first", k->name, 0, 0);
    if (c->state->mode == IN_TIME && (k->causality != INPUT || k->kind != REAL))
        return fail(c, "%s can be set in event mode alone, not in continuous-time mode", k->name, 0, 0);
    FOR_LANES {
        const double x = value[lane];
        if (!isfinite(x) && !(k->may_lack && isnan(x)))
            return fail(c, "%s = %g at time %g s is not a finite number", k->name, x, c->state->time);
        if (x < k->minimum) return fail(c, "%s = %g is below its minimum %g", k->name, x, k->minimum);
        if (x > k->maximum) return fail(c, "%s = %g is above its maximum %g", k->name, x, k->maximum);
        c->parts[at.part].v[AT(at.variable)] = x;
    }
    if (k->causality <= FIXED_PARAMETER) c->parts[at.part].ready = 0;
    c->state->outputs = STALE;
    return 0;
}

/* A small change of a state that a variable shows, of which the tangent reads `d_x`; 0: of none. */
static int seed_state(Part* p, unsigned variable, double change) {
    for (unsigned i = 0; i < p->model->n_continuous; i++) {
        if (p->model->continuous[i].reference != variable) continue;
        p->d_x[p->model->continuous[i].place] += change;
        return 1;
    }
    return 0;
}

int core_derivative(Instance* c, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                    size_t n_known, const double seed[], double result[]) {
    if (check_mode(c, INITIALIZING, TERMINATED, "a directional derivative", "asked for")) return -1;
    FOR_EACH_PART(p) memset(p->change, 0, p->model->n_variables * sizeof(double));
    if (c->exchange) memset(c->parts[0].d_x, 0, c->parts[0].model->n_states * sizeof(double));
    for (size_t i = 0; i < n_known; i++) {
        Port at = fmu.ports[known[i] < fmu.n_ports ? known[i] : 0];
        for (const unsigned end = at.variable + at.count; at.variable < end; at.variable++, seed++) {
            if (c->exchange && c->state->mode >= STEPPING && seed_state(&c->parts[0], at.variable, *seed))
                continue;
            if (at.variable == 0 || at.variable >= fmu.models[at.part]->first_output)
                return fail(c, "%sdirectional derivative: value reference %.0f is no input or parameter", "",
                            known[i], 0);
            c->parts[at.part].change[at.variable] += *seed;
        }
    }
    for (size_t i = 0; i < n_unknown; i++) {
        const Port at = fmu.ports[unknown[i] < fmu.n_ports ? unknown[i] : 0];
        if (at.variable < fmu.models[at.part]->first_output)
            return fail(c, "%sdirectional derivative: value reference %.0f is no output", "", unknown[i], 0);
    }
    if (c->state->mode < STEPPING) {
        if (settle(c, 1)) return -1;
    } else {
        FOR_EACH_PART(p) p->model->tangent(p, 0, p->noise, p->change); /* connected inputs are held */
    }
    for (size_t i = 0; i < n_unknown; i++) {
        const Port at = fmu.ports[unknown[i]];
        for (unsigned k = 0; k < at.count; k++) *result++ = c->parts[at.part].change[at.variable + k];
    }
    return 0;
}

/* ---- life cycle ---- */

/* Where the simulation begins and must end; HUGE_VAL: where it ends is not known. */
int core_set_times(Instance* c, double start_time, double stop_time) {
    if (check_mode(c, INSTANTIATED, INSTANTIATED, "start and stop time", "set")) return -1;
    if (!isfinite(start_time)) return fail(c, "%sstart time %g is not finite", "", start_time, 0);
    if (!(stop_time >= start_time))
        return fail(c, "%sstop time %g s is before the start time %g s", "", stop_time, start_time);
    c->state->start_time = start_time;
    c->state->stop_time = stop_time;
    return 0;
}

int core_enter_initialization(Instance* c) {
    if (check_mode(c, INSTANTIATED, INSTANTIATED, "initialization", "entered")) return -1;
    c->state->time = c->state->start_time;
    FOR_EACH_PART(p) FOR_LANES p->v[lane] = c->state->time;
    c->state->mode = INITIALIZING;
    c->state->outputs = STALE;
    return 0;
}

int core_exit_initialization(Instance* c) {
    if (check_mode(c, INITIALIZING, INITIALIZING, "initialization", "ended")) return -1;
    if (fmu.n_connections && settle(c, 0)) return -1;
    FOR_EACH_PART(p) receive(p, 1); /* what enters states alone may have come after its part's visit */
    FOR_EACH_PART(p)
        if (begin(c, p) || check_states(c, p)) return -1;
    c->state->mode = c->exchange ? IN_EVENT : STEPPING;
    c->state->outputs = STALE;
    return 0;
}

int core_step(Instance* c, double time, double h) {
    State* s = c->state;
    if (check_mode(c, STEPPING, STEPPING, "a step", "made")) return -1;
    if (!(h > 0) || !isfinite(h))
        return fail(c, "%scommunication step size %g s must be positive", "", h, 0);
    if (!(fabs(time - s->time) <= 1e-3 * h))
        return fail(c, "%sdoStep at %.9g s, but the FMU is at %.9g s", "", time, s->time);
    if (time + h > s->stop_time + 1e-3 * h) /* as far as it may be off the time that was reached */
        return fail(c, "%sdoStep to %.9g s, beyond the stop time %.9g s", "", time + h, s->stop_time);
    int too_long = h / fmu.step > 1e9;
    FOR_EACH_PART(p) too_long |= h / p->model->max_step > 1e9;
    if (too_long) return fail(c, "%scommunication step size %g s is too long", "", h, 0);
    double n = ceil(h / fmu.step - 1e-6);
    double dt = n > 1 ? h / n : h;
    if (n > 1 && fabs(dt - fmu.step) <= 1e-9 * fmu.step) dt = fmu.step;
    if (step_often(c, time, dt, n > 1 ? (long)n : 1)) {
        s->mode = FAILED;
        return -1;
    }
    s->time = time + h;
    return 0;
}

int core_terminate(Instance* c) {
    if (check_mode(c, STEPPING, IN_TIME, "the simulation", "terminated")) return -1;
    c->state->mode = TERMINATED;
    return 0;
}

/* ---- model exchange: the part alone, integrated by a solver outside; not of several aircraft ---- */

int core_can_exchange(void) { return LANES == 1 && fmu.n_parts == 1 && fmu.models[0]->continuous != NULL; }

static int check_count(Instance* c, size_t n, unsigned expected) {
    if (n == expected) return 0;
    return fail(c, "%sthe importer asks for %.0f numbers, there are %.0f", "", (double)n, expected);
}

/* A solver may look beyond the stop time on its way there; what it accepts may not be beyond. */
static int check_stop(Instance* c) {
    const State* s = c->state;
    if (s->time <= s->stop_time + 1e-9 * (fabs(s->stop_time) + 1)) return 0;
    return fail(c, "%sthe time %.9g s is beyond the stop time %.9g s", "", s->time, s->stop_time);
}

/* Whether this instance has what a solver outside asks for, which is not to be had before `from`. */
static int check_exchange(Instance* c, int from, const char* what) {
    if (!c->exchange) return fail(c, "%s: this instance is for co-simulation", what, 0, 0);
    return check_mode(c, from, TERMINATED, what, "asked for");
}

/* Instants that nothing felt were passed over: signals count as having always been as they are. */
static void wake(Part* p) {
    const Sampling* s = p->model->sampling;
    double* line = p->record;
    if (!s->n_lines) return;
    s->signals(p, p->signal);
    for (unsigned i = 0; i < s->n_lines; line += s->lines[i].capacity, i++)
        for (unsigned k = 0; k < s->lines[i].capacity; k++) line[k] = p->signal[i];
}

/* The instant that is due, if one is, and whether it moved what the solver integrates. */
static int take_instant(Instance* c, double instant) {
    Part* p = &c->parts[0];
    const Model* m = p->model;
    if (instant <= *p->samples) return 0;
    prepare(p);
    if (instant > *p->samples + 1) wake(p);
    *p->samples = instant;
    for (unsigned i = 0; i < m->n_continuous; i++)
        p->change[m->continuous[i].derivative] = p->x[m->continuous[i].place]; /* as they were */
    if (sample(c, p)) return -1;
    for (unsigned i = 0; i < m->n_continuous; i++)
        c->state->moved |= p->change[m->continuous[i].derivative] != p->x[m->continuous[i].place];
    c->state->outputs = STALE;
    return check_states(c, p);
}

/* Number of the last sample instant; -1 where nothing feels them. */
static double last_instant(const Instance* c) {
    const Part* p = &c->parts[0];
    const Sampling* s = p->model->sampling;
    if (!s || p->model->rests(p)) return -1;
    return floor((c->state->time - c->state->start_time) / p->v[s->period] + SAMPLE_TOLERANCE);
}

/* An instant sees the inputs before those that the event brings, as that at the end of a step does. */
int core_enter_event(Instance* c) {
    if (check_mode(c, IN_EVENT, IN_TIME, "event mode", "entered") || check_stop(c)) return -1;
    c->state->mode = IN_EVENT;
    return take_instant(c, last_instant(c));
}

int core_enter_time(Instance* c) {
    if (check_mode(c, IN_EVENT, IN_EVENT, "continuous-time mode", "entered")) return -1;
    c->state->mode = IN_TIME;
    return 0;
}

int core_set_time(Instance* c, double time) {
    if (check_mode(c, IN_EVENT, IN_TIME, "the time", "set")) return -1;
    if (!isfinite(time)) return fail(c, "%stime %g is not finite", "", time, 0);
    c->state->time = c->parts[0].v[0] = time;
    return 0;
}

int core_completed_step(Instance* c) {
    return check_mode(c, IN_TIME, IN_TIME, "an integrator step", "completed") || check_stop(c) ? -1 : 0;
}

/* Everything is evaluated when it is asked for. */
int core_evaluate(Instance* c) {
    if (c->state->mode == INITIALIZING) return 0;
    return check_mode(c, IN_EVENT, IN_EVENT, "discrete states", "evaluated");
}

int core_update(Instance* c, int* states_moved, double* next) {
    const Part* p = &c->parts[0];
    const double instant = last_instant(c);
    if (check_mode(c, IN_EVENT, IN_EVENT, "discrete states", "updated") || take_instant(c, instant)) return -1;
    *states_moved = c->state->moved;
    c->state->moved = 0;
    *next = HUGE_VAL;
    if (instant >= 0) *next = c->state->start_time + (instant + 1) * p->v[p->model->sampling->period];
    return 0;
}

int core_get_states(Instance* c, double x[], size_t n) {
    const Part* p = &c->parts[0];
    if (check_exchange(c, INITIALIZING, "states") || check_count(c, n, p->model->n_continuous)) return -1;
    if (c->state->mode < STEPPING && refresh(c)) return -1;
    for (size_t i = 0; i < n; i++) x[i] = p->x[p->model->continuous[i].place];
    return 0;
}

int core_set_states(Instance* c, const double x[], size_t n) {
    Part* p = &c->parts[0];
    if (check_count(c, n, p->model->n_continuous) || check_mode(c, IN_TIME, IN_TIME, "states", "set"))
        return -1;
    for (size_t i = 0; i < n; i++) p->x[p->model->continuous[i].place] = x[i];
    c->state->outputs = STALE;
    return check_states(c, p);
}

int core_get_derivatives(Instance* c, double dx[], size_t n) {
    const Part* p = &c->parts[0];
    if (check_exchange(c, INITIALIZING, "derivatives") || check_count(c, n, p->model->n_continuous) ||
        refresh(c))
        return -1;
    for (size_t i = 0; i < n; i++) dx[i] = p->v[p->model->continuous[i].derivative];
    return 0;
}

int core_get_nominals(Instance* c, double x[], size_t n) {
    const Model* m = c->parts[0].model;
    if (check_exchange(c, INSTANTIATED, "nominal values") || check_count(c, n, m->n_continuous)) return -1;
    for (size_t i = 0; i < n; i++) x[i] = m->continuous[i].nominal;
    return 0;
}

int core_get_crossings(Instance* c, double z[], size_t n) {
    const Part* p = &c->parts[0];
    if (check_exchange(c, INITIALIZING, "event indicators") || check_count(c, n, p->model->n_crossings) ||
        refresh(c))
        return -1;
    for (size_t i = 0; i < n; i++) z[i] = p->v[p->model->crossings[i]];
    return 0;
}

/* ---- saved states ---- */

static size_t tag_size(void) { return strlen(fmu.token) + 1; }

size_t core_saved_size(const Instance* c) { return tag_size() + c->state_size; }

void core_save(const Instance* c, char* bytes) {
    memcpy(bytes, fmu.token, tag_size());
    bytes[tag_size() - 1] = c->exchange; /* in place of the end of the text */
    memcpy(bytes + tag_size(), c->state, c->state_size);
}

int core_check_saved(Instance* c, const char* bytes, size_t size) {
    if (size != core_saved_size(c))
        return fail(c, "%ssaved state has %.0f bytes, expected %.0f", "", (double)size,
                    (double)core_saved_size(c));
    if (memcmp(bytes, fmu.token, tag_size() - 1) != 0)
        return fail(c, "%ssaved state belongs to another FMU or another version of this one", "", 0, 0);
    if (bytes[tag_size() - 1] != c->exchange)
        return fail(c, "%ssaved state is of the other kind, co-simulation or model exchange", "", 0, 0);
    return 0;
}

int core_restore(Instance* c, const char* bytes, size_t size) {
    if (core_check_saved(c, bytes, size)) return -1;
    memcpy(c->state, bytes + tag_size(), c->state_size);
    FOR_EACH_PART(p) p->ready = 0;
    return 0;
}
