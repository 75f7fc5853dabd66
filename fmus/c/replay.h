/* A recorded flight as a model: every output is a signal of `record.bin` among the resources.
 *
 * Included at the end of part_NAME.c, which holds the tables.
 *
 * record.bin, little endian: "UAVTWIN1", uint64 number of signals; per signal uint64 number of
 * samples, uint64 1 for linear interpolation or 0 for hold, double longest gap in s, then the
 * times (s, increasing) and the values. Outputs come in pairs: the signals, then their validity.
 * A held sample is valid for the longest gap, the last one of a linear signal too; between two
 * samples further apart a linear signal is valid at the samples alone. Where a signal is not valid
 * it holds the sample before (before the record the first one): nothing is extrapolated.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    uint64_t count, linear;
    double longest_gap;
    const double *time, *value;
    uint64_t cursor; /* where the last query ended: speeds up the next, never changes its answer */
} Signal;

typedef struct {
    double* bytes;
    Signal signals[N_SIGNALS];
} Record;

/* Windows takes UTF-8 paths, which FMI prescribes, in its wide functions alone. */
#ifdef _WIN32
__declspec(dllimport) int __stdcall MultiByteToWideChar(unsigned page, unsigned long flags, const char* text,
                                                        int size, wchar_t* wide, int wide_size);
static FILE* open_read(const char* path) {
    wchar_t wide[4200];
    return MultiByteToWideChar(65001 /* UTF-8 */, 0, path, -1, wide, 4200) ? _wfopen(wide, L"rb") : NULL;
}
#else
static FILE* open_read(const char* path) { return fopen(path, "rb"); }
#endif

static void model_close(void* data) {
    if (!data) return;
    free(((Record*)data)->bytes);
    free(data);
}

static int model_open(const char* resources, void** data, char* message, size_t size) {
    char path[4200];
    size_t length = strlen(resources);
    const char* slash = length && (resources[length - 1] == '/' || resources[length - 1] == '\\') ? "" : "/";
    snprintf(path, sizeof path, "%s%s" FOLDER "record.bin", resources, slash);
    FILE* file = open_read(path);
    if (!file) {
        snprintf(message, size, "cannot open the recorded flight %.200s", path);
        return -1;
    }
    Record* r = calloc(1, sizeof *r);
    long bytes = fseek(file, 0, SEEK_END) == 0 ? ftell(file) : -1;
    rewind(file);
    int ok = r && bytes >= 16 && bytes % 8 == 0 && (r->bytes = malloc((size_t)bytes)) &&
             fread(r->bytes, 1, (size_t)bytes, file) == (size_t)bytes;
    fclose(file);
    uint64_t words = (uint64_t)bytes / 8, at = 2, count = 0;
    if (ok) {
        memcpy(&count, r->bytes + 1, 8);
        ok = memcmp(r->bytes, "UAVTWIN1", 8) == 0 && count == N_SIGNALS;
    }
    for (uint64_t i = 0; ok && i < count; i++) {
        Signal* s = &r->signals[i];
        ok = at + 3 <= words;
        if (!ok) break;
        memcpy(&s->count, r->bytes + at, 8);
        memcpy(&s->linear, r->bytes + at + 1, 8);
        s->longest_gap = r->bytes[at + 2];
        at += 3;
        ok = s->count >= 1 && s->count <= (words - at) / 2;
        if (!ok) break;
        s->time = r->bytes + at;
        s->value = s->time + s->count;
        at += 2 * s->count;
    }
    if (!ok) {
        snprintf(message, size, "%.200s is damaged or belongs to another FMU", path);
        model_close(r);
        return -1;
    }
    *data = r;
    return 0;
}

static void model_initial(const Part* p, double* x) { (void)p, (void)x; }

/* Outputs depend on time alone. */
static void model_tangent(const Part* p, int starting, const double* noise, double* change) {
    (void)p, (void)starting, (void)noise;
    for (unsigned i = FIRST_OUTPUT; i < N_VARIABLES; i++) change[i] = 0;
}

/* Index of the last sample at or before t; the caller knows that there is one. */
static uint64_t locate(Signal* s, double t) {
    uint64_t i = s->cursor;
    if (s->time[i] <= t) {
        for (int k = 0; k < 4; k++, i++)
            if (i + 1 >= s->count || s->time[i + 1] > t) return s->cursor = i;
    }
    uint64_t low = 0, high = s->count; /* time[low] <= t < time[high] */
    while (high - low > 1) {
        uint64_t middle = low + (high - low) / 2;
        if (s->time[middle] <= t) low = middle;
        else high = middle;
    }
    return s->cursor = low;
}

/* A sample counts from this much before its time: communication points carry rounding errors. */
#define TIME_TOLERANCE 1e-9

static void model_outputs(Part* p) {
    Record* r = p->data;
    double t = p->v[0] + TIME_TOLERANCE;
    for (int i = 0; i < N_SIGNALS; i++) {
        Signal* k = &r->signals[i];
        double value, valid;
        if (t < k->time[0]) {
            value = k->value[0];
            valid = 0;
        } else {
            uint64_t j = locate(k, t);
            double age = p->v[0] - k->time[j]; /* from -TIME_TOLERANCE on */
            value = k->value[j];
            valid = age <= k->longest_gap + TIME_TOLERANCE;
            if (k->linear && j + 1 < k->count) {
                double span = k->time[j + 1] - k->time[j];
                int bridged = span <= k->longest_gap + TIME_TOLERANCE;
                valid = bridged || age <= TIME_TOLERANCE;
                if (bridged) value += (k->value[j + 1] - value) * (age / span);
            }
        }
        p->v[FIRST_OUTPUT + i] = value;
        p->v[FIRST_OUTPUT + N_SIGNALS + i] = valid;
    }
}

const Model MODEL = {
    .n_variables = N_VARIABLES,
    .first_input = FIRST_INPUT,
    .first_output = FIRST_OUTPUT,
    .variables = variables,
    .n_states = N_STATES,
    .state_names = state_names,
    .max_step = MAX_STEP,
    .open = model_open,
    .close = model_close,
    .initial = model_initial,
    .outputs = model_outputs,
    .tangent = model_tangent,
};
