/* The inner loops of the grey room. What each must do is said, and checked against NumPy, in Python: see
 * kernels.py and its tests. No allocation and no threads: every call works on its caller's arrays. */

#include <stddef.h>
#include <stdint.h>
#include <string.h>
#ifdef __x86_64__
#include <cpuid.h>
#include <immintrin.h>
#endif

#define ALWAYS_INLINE __attribute__((always_inline)) static inline

enum { LEVELS = 256, BLOCK = 2048, CODES = 256, CELLS = 1 << 24 };

/* level = min(255, floor(floor(fine (i R + j G + k B)) scale + offset)). All sums are integers below 2^24, which
 * float32 holds exactly; `offset` keeps the last product away from the integers, so that it rounds to neither side. */
typedef struct {
    float red, green, blue, fine, scale, offset;
} Rule;

ALWAYS_INLINE int32_t level_of(float r, float g, float b, const Rule *rule)
{
    int32_t sum = (int32_t)((rule->red * r + rule->green * g + rule->blue * b) * rule->fine);
    int32_t level = (int32_t)((float)sum * rule->scale + rule->offset);
    return level < LEVELS - 1 ? level : LEVELS - 1;
}

#define LEVELS_LOOP                                                     \
    const Rule local = *rule;                                           \
    for (size_t i = 0; i < n; i++)                                      \
        out[i] = (uint8_t)level_of(r[i], g[i], b[i], &local);

typedef void Levels(const float *restrict r, const float *restrict g, const float *restrict b, size_t n,
                    const Rule *rule, uint8_t *restrict out);

static Levels levels_plain, *levels = levels_plain;

static void levels_plain(const float *restrict r, const float *restrict g, const float *restrict b, size_t n,
                         const Rule *rule, uint8_t *restrict out)
{
    LEVELS_LOOP
}

#ifdef __x86_64__
__attribute__((target("avx2,fma"))) static void levels_avx2(const float *restrict r, const float *restrict g,
                                                            const float *restrict b, size_t n,
                                                            const Rule *rule, uint8_t *restrict out)
{
    LEVELS_LOOP
}

#endif

/* A table ordered by R-G, B-G, G: the colours of a photograph lie close together in it. */
static inline uint32_t place_of(uint8_t r, uint8_t g, uint8_t b)
{
    return (uint32_t)(uint8_t)(r - g) << 16 | (uint32_t)(uint8_t)(b - g) << 8 | g;
}

typedef void Places(const uint8_t *restrict rgb, size_t n, uint32_t *restrict places);

static Places places_plain, *places_of = places_plain;

static void places_plain(const uint8_t *restrict rgb, size_t n, uint32_t *restrict places)
{
    for (size_t i = 0; i < n; i++)
        places[i] = place_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
}

#ifdef __x86_64__
/* Eight pixels at a time: G B R 0 of each, less 0 G G 0. */
__attribute__((target("avx2"))) static void places_avx2(const uint8_t *restrict rgb, size_t n,
                                                        uint32_t *restrict places)
{
    const __m256i colours = _mm256_setr_epi8(1, 2, 0, -1, 4, 5, 3, -1, 7, 8, 6, -1, 10, 11, 9, -1, 1, 2, 0, -1, 4, 5,
                                             3, -1, 7, 8, 6, -1, 10, 11, 9, -1);
    const __m256i green = _mm256_setr_epi8(-1, 1, 1, -1, -1, 4, 4, -1, -1, 7, 7, -1, -1, 10, 10, -1, -1, 1, 1, -1, -1,
                                           4, 4, -1, -1, 7, 7, -1, -1, 10, 10, -1);
    size_t i = 0;
    for (; i + 10 <= n; i += 8) { /* 28 bytes are read, of which 24 are used */
        __m128i first = _mm_loadu_si128((const void *)(rgb + 3 * i));
        __m128i second = _mm_loadu_si128((const void *)(rgb + 3 * i + 12));
        __m256i eight = _mm256_inserti128_si256(_mm256_castsi128_si256(first), second, 1);
        eight = _mm256_sub_epi8(_mm256_shuffle_epi8(eight, colours), _mm256_shuffle_epi8(eight, green));
        _mm256_storeu_si256((void *)(places + i), eight);
    }
    places_plain(rgb + 3 * i, n - i, places + i);
}
#endif

/* A count is low + FULL * high, and low is 0 only where all is: half the memory to run through, and more than enough
 * to count to. */
enum { FULL = 65535, STRIDE = 16 };

static inline void add_one(uint32_t place, uint16_t *low, uint32_t *high)
{
    if (__builtin_expect(++low[place] == 0, 0)) {
        low[place] = 1;
        high[place]++;
    }
}

static void add_places(const uint32_t *places, size_t n, uint16_t *low, uint32_t *high)
{
    size_t part = n / 4; /* neighbours often share a colour, and one addition would wait for the other */
    for (size_t i = 0; i < part; i++) {
        add_one(places[i], low, high);
        add_one(places[i + part], low, high);
        add_one(places[i + 2 * part], low, high);
        add_one(places[i + 3 * part], low, high);
    }
    for (size_t i = 4 * part; i < n; i++)
        add_one(places[i], low, high);
}

void count_colours_8(const uint8_t *rgb, size_t n, uint16_t *low, uint32_t *high)
{
    uint32_t places[BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t m = n - start < BLOCK ? n - start : BLOCK;
        places_of(rgb + 3 * start, m, places);
        add_places(places, m, low, high);
    }
}

void count_colours_16(const uint16_t *rgb, size_t n, const uint8_t *code, uint16_t *low, uint32_t *high)
{
    uint32_t places[BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t m = n - start < BLOCK ? n - start : BLOCK;
        const uint16_t *p = rgb + 3 * start;
        for (size_t i = 0; i < m; i++)
            places[i] = place_of(code[p[3 * i]], code[p[3 * i + 1]], code[p[3 * i + 2]]);
        add_places(places, m, low, high);
    }
}

/* Places in ascending order, and their counts, as pairs of whole numbers: how many places were passed over since the
 * one before, and the count; seven bits a byte, the least first, and one that says whether there are more. */
enum { MOST_BYTES = 14 };

static inline uint8_t *put_number(uint8_t *at, uint64_t value)
{
    for (; value > 127; value >>= 7)
        *at++ = (uint8_t)(value | 128);
    *at++ = (uint8_t)value;
    return at;
}

/* Of places (n) and counts (n): writes at most MOST_BYTES each, and returns how many bytes. */
size_t pack_cells(const uint32_t *places, const uint64_t *counts, size_t n, uint8_t *out)
{
    uint8_t *at = out;
    uint32_t next = 0;
    for (size_t i = 0; i < n; i++) {
        at = put_number(put_number(at, places[i] - next), counts[i]);
        next = places[i] + 1;
    }
    return (size_t)(at - out);
}

static inline const uint8_t *get_number(const uint8_t *at, const uint8_t *end, uint64_t *value)
{
    *value = 0;
    for (uint32_t shift = 0; at < end && shift < 63; shift += 7) {
        *value |= (uint64_t)(*at & 127) << shift;
        if (!(*at++ & 128))
            return at;
    }
    return NULL;
}

/* Whether `data` is what `pack_cells` could have written, each count 1 at least and `mass` their sum: 0 if not. */
int packed_is_sound(const uint8_t *data, size_t size, uint64_t mass)
{
    const uint8_t *at = data, *end = data + size;
    uint64_t next = 0, gap, count;
    while (at != end) {
        if (!(at = get_number(at, end, &gap)) || !(at = get_number(at, end, &count)) || gap >= CELLS - next ||
            count == 0 || count > mass)
            return 0;
        next += gap + 1;
        mass -= count;
    }
    return mass == 0;
}

/* Adds what is sound to a table, or where `sums` is not NULL, to (CELLS) numbers. */
void add_packed(const uint8_t *data, size_t size, uint16_t *low, uint32_t *high, uint64_t *sums)
{
    const uint8_t *at = data, *end = data + size;
    uint64_t next = 0, gap, count;
    while (at != end) {
        if (end - at >= 2 && !((at[0] | at[1]) & 128)) {
            gap = at[0], count = at[1];
            at += 2;
        } else
            at = get_number(get_number(at, end, &gap), end, &count);
        next += gap;
        if (sums)
            sums[next] += count;
        else if (low[next] + count <= FULL)
            low[next] = (uint16_t)(low[next] + count);
        else {
            uint64_t sum = low[next] + count + (uint64_t)FULL * high[next], full = (sum - 1) / FULL;
            low[next] = (uint16_t)(sum - full * FULL);
            high[next] = (uint32_t)full;
        }
        next++;
    }
}

static uint32_t spread(uint32_t v)
{
    uint32_t s = 0;
    for (int bit = 0; bit < 8; bit++)
        s |= (v >> bit & 1) << 3 * bit;
    return s;
}

/* The occupied places from `start` on, as many as `out` has room for; `start` moves behind the last one. */
static size_t next_places(const uint16_t *low, uint32_t *start, uint32_t end, uint32_t *out, size_t room)
{
    size_t found = 0;
    uint32_t place = *start;
    for (; place < end && found + STRIDE <= room; place += STRIDE) {
        uint64_t four[STRIDE / 4];
        memcpy(four, low + place, sizeof four);
        if (four[0] | four[1] | four[2] | four[3])
            for (uint32_t i = place; i < place + STRIDE; i++) {
                out[found] = i;
                found += low[i] != 0;
            }
    }
    *start = place;
    return found;
}

/* As `pack_cells`, of a table from `start` on, as much as `out` of `room` bytes holds; where it is to be emptied what is
 * packed is then no longer in the table. `start` moves behind it, and `passed` is how many places lie between it and the last one packed. */
size_t pack_table(uint16_t *low, uint32_t *high, int emptied, uint32_t *start, uint32_t *passed, uint8_t *out,
                  size_t room)
{
    uint32_t places[BLOCK], next = *start - *passed;
    uint8_t *at = out;
    while (*start < CELLS && (size_t)(at - out) + MOST_BYTES * BLOCK <= room) {
        size_t n = next_places(low, start, CELLS, places, BLOCK);
        for (size_t i = 0; i < n; i++) {
            uint32_t place = places[i], gap = place - next, count = low[place];
            if (emptied)
                low[place] = 0;
            next = place + 1;
            if (high[place]) {
                at = put_number(put_number(at, gap), count + (uint64_t)FULL * high[place]);
                if (emptied)
                    high[place] = 0;
            } else if ((gap | count) > 127)
                at = put_number(put_number(at, gap), count);
            else {
                *at++ = (uint8_t)gap;
                *at++ = (uint8_t)count;
            }
        }
    }
    *passed = *start - next;
    return (size_t)(at - out);
}

/* The occupied places of a table, each as key << 24 | place, or how many there are where `out` is NULL. The key is
 * the codes of R, G, B with their bits interleaved: sorted keys run through cubes within cubes. */
size_t occupied(const uint16_t *low, uint64_t *out)
{
    uint32_t wide[CODES], places[BLOCK];
    for (uint32_t v = 0; v < CODES; v++)
        wide[v] = spread(v);
    size_t found = 0;
    for (uint32_t start = 0; start < CELLS;) {
        size_t n = next_places(low, &start, CELLS, places, BLOCK);
        for (size_t i = 0; out && i < n; i++) {
            uint32_t place = places[i], g = place & 255;
            uint32_t r = (uint8_t)((place >> 16) + g), b = (uint8_t)((place >> 8) + g);
            out[found + i] = (uint64_t)(wide[r] << 2 | wide[g] << 1 | wide[b]) << 24 | place;
        }
        found += n;
    }
    return found;
}

/* Sorts what `occupied` gave by its keys; `other` is scratch of the same length. */
void sort_places(uint64_t *keys, uint64_t *other, size_t n)
{
    for (int shift = 24; shift < 48; shift += 12) {
        uint32_t at[1 << 12] = {0}, sum = 0;
        for (size_t i = 0; i < n; i++)
            at[keys[i] >> shift & 4095]++;
        for (uint32_t v = 0; v < 1 << 12; v++) {
            uint32_t count = at[v];
            at[v] = sum;
            sum += count;
        }
        for (size_t i = 0; i < n; i++)
            other[at[keys[i] >> shift & 4095]++] = keys[i];
        uint64_t *swap = keys;
        keys = other;
        other = swap;
    }
}

/* Places in the order of their keys, gathered in cubes of 2^bits codes: the least and greatest codes of each and its
 * mass, in planes of `n`. Returns how many cubes. */
size_t gather(const uint64_t *keys, size_t n, const uint64_t *masses, uint32_t bits, uint8_t *low, uint8_t *high,
              uint64_t *mass)
{
    size_t cubes = 0;
    for (size_t i = 0; i < n; i++) {
        uint8_t g = (uint8_t)keys[i];
        uint8_t code[3] = {(uint8_t)((keys[i] >> 16) + g), g, (uint8_t)((keys[i] >> 8) + g)};
        int opens = i == 0 || (keys[i] ^ keys[i - 1]) >> 24 >> 3 * bits;
        if (opens)
            mass[cubes++] = 0;
        mass[cubes - 1] += masses[i];
        for (int c = 0; c < 3; c++) {
            uint8_t *least = low + c * n + cubes - 1, *most = high + c * n + cubes - 1;
            *least = opens || code[c] < *least ? code[c] : *least;
            *most = opens || code[c] > *most ? code[c] : *most;
        }
    }
    return cubes;
}

static void add_masses(const uint16_t *at, const uint64_t *mass, size_t n, uint64_t *out)
{
    size_t half = n / 2; /* neighbours often fall together, and one addition would wait for the other */
    for (size_t i = 0; i < half; i++) {
        out[at[i]] += mass[i];
        out[at[i + half]] += mass[i + half];
    }
    if (n & 1)
        out[at[n - 1]] += mass[n - 1];
}

/* Masses of STRIDE colours that differ in G alone, by R-G, B-G and the G of the first: whatever the weights, their
 * greys are neighbours too. */
enum { RUNS = 512, WIDTH = LEVELS + 2 * STRIDE };

typedef struct {
    uint64_t mass[RUNS][STRIDE];
    int16_t red[RUNS], blue[RUNS], green[RUNS];
} Runs;

/* The grey of weights i, j, k in hundredths, (i R + j G + k B + 50) / 100, is G + (i (R-G) + k (B-G) + 50) / 100. */
static void count_runs(const Runs *runs, size_t n, const int16_t *weights, size_t m, uint64_t *out)
{
    uint16_t at[RUNS], before[RUNS];
    for (size_t t = 0; t < m; t++, out += WIDTH) {
        int16_t red = weights[2 * t], blue = weights[2 * t + 1];
        for (size_t i = 0; i < n; i++) { /* divided above 0, then back by 256; STRIDE places lie before level 0 */
            uint16_t sum = (uint16_t)(red * runs->red[i] + blue * runs->blue[i] + 50 + 100 * LEVELS);
            at[i] = (uint16_t)(sum / 100 + runs->green[i] + STRIDE - LEVELS);
        }
        for (size_t i = 0; i < n; i++)
            if (t == 0 || at[i] != before[i])
                for (size_t k = 0; k < STRIDE; k++)
                    out[at[i] + k] += runs->mass[i][k];
        for (size_t i = 0; t && i < n; i++)
            if (at[i] != before[i])
                for (size_t k = 0; k < STRIDE; k++)
                    out[before[i] + k] -= runs->mass[i][k];
        memcpy(before, at, sizeof at);
    }
}

/* Counts of grey levels of the colours of a table, from place `start` to `end`, whole STRIDEs; where `sums` is not NULL
 * it has the masses of those that are not 0 in `low`. Weights: R and B in hundredths, (m, 2). `out` (m, WIDTH) is of the
 * first weights the counts, of any others what changes, modulo 2^64; the outer STRIDE places come to 0 in sum. */
void count_levels(const uint16_t *low, const uint32_t *high, const uint64_t *sums, uint32_t start, uint32_t end,
                  const int16_t *weights, size_t m, uint64_t *out)
{
    Runs runs;
    uint32_t places[BLOCK];
    size_t n = 0;
    while (start < end) {
        size_t found = next_places(low, &start, end, places, BLOCK);
        for (size_t i = 0; i < found; i++) {
            uint32_t place = places[i];
            uint8_t g = (uint8_t)place, first = g / STRIDE * STRIDE;
            int16_t red = (uint8_t)((place >> 16) + g) - g, blue = (uint8_t)((place >> 8) + g) - g;
            if (n == 0 || red != runs.red[n - 1] || blue != runs.blue[n - 1] || first != runs.green[n - 1]) {
                if (n == RUNS) {
                    count_runs(&runs, n, weights, m, out);
                    n = 0;
                }
                memset(runs.mass[n], 0, sizeof *runs.mass);
                runs.red[n] = red, runs.blue[n] = blue, runs.green[n++] = first;
            }
            runs.mass[n - 1][g - first] = sums ? sums[place] : low[place] + (uint64_t)FULL * high[place];
        }
    }
    count_runs(&runs, n, weights, m, out);
}

/* Mass by length of the run of levels less one, and first level: (256, 256). Returns the longest. */
static uint32_t runs_of(const float *low, const float *high, const uint64_t *mass, size_t n, const Rule *rule,
                        uint64_t *runs)
{
    uint8_t first[BLOCK], last[BLOCK];
    uint16_t run[BLOCK];
    uint32_t longest = 0;
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t length = n - start < BLOCK ? n - start : BLOCK;
        levels(low + start, low + n + start, low + 2 * n + start, length, rule, first);
        levels(high + start, high + n + start, high + 2 * n + start, length, rule, last);
        uint16_t most = 0;
        for (size_t i = 0; i < length; i++) {
            run[i] = (uint16_t)((last[i] - first[i]) * LEVELS + first[i]);
            most = run[i] > most ? run[i] : most;
        }
        if (most / LEVELS > longest) {
            memset(runs + (longest + 1) * LEVELS, 0, (most / LEVELS - longest) * LEVELS * sizeof *runs);
            longest = most / LEVELS;
        }
        add_masses(run, mass + start, length, runs);
    }
    return longest;
}

/* The sum of squared counts for each rule, if the mass of each box were spread evenly over its run of levels: (m).
 * `runs` is scratch, (256, 256). */
void estimate_boxes(const float *low, const float *high, const uint64_t *mass, size_t n, const Rule *rules, size_t m,
                    uint64_t *runs, double *out)
{
    for (size_t k = 0; k < m; k++) {
        memset(runs, 0, LEVELS * sizeof *runs);
        uint32_t longest = runs_of(low, high, mass, n, &rules[k], runs);
        double count[LEVELS + 1] = {0}, square = 0;
        for (uint32_t extra = 0; extra <= longest; extra++)
            for (uint32_t first = 0; first + extra < LEVELS; first++) {
                double share = (double)runs[extra * LEVELS + first] / (extra + 1);
                count[first] += share;
                count[first + extra + 1] -= share;
            }
        for (uint32_t level = 1; level < LEVELS; level++)
            count[level] += count[level - 1];
        for (uint32_t level = 0; level < LEVELS; level++)
            square += count[level] * count[level];
        out[k] = square;
    }
}

/* For each rule the bin, `width` wide, in which the boxes in the order of their sums reach a mass of `needed`:
 * (m). `bins` is scratch, of `most`; sums beyond count in the last. */
void quantile_boxes(const float *planes, const uint64_t *mass, size_t n, const Rule *rules, size_t m,
                    float width, uint64_t needed, uint64_t *bins, uint32_t most, uint32_t *out)
{
    const float *r = planes, *g = r + n, *b = g + n, inverse = 1 / width; /* exact: a power of two */
    for (size_t k = 0; k < m; k++) {
        const Rule local = rules[k];
        memset(bins, 0, most * sizeof *bins);
        for (size_t i = 0; i < n; i++) {
            uint32_t bin = (uint32_t)((local.red * r[i] + local.green * g[i] + local.blue * b[i]) * inverse);
            bins[bin < most ? bin : most - 1] += mass[i];
        }
        uint64_t reached = 0;
        uint32_t bin = 0;
        while (bin < most - 1 && (reached += bins[bin]) < needed)
            bin++;
        out[k] = bin;
    }
}

static void count_block(const float *planes, size_t n, const Rule *rules, size_t m, uint64_t *out)
{
    uint8_t level[BLOCK];
    uint32_t part[4][LEVELS]; /* one block may all be of one level, and additions to it would wait */
    for (size_t k = 0; k < m; k++) {
        levels(planes, planes + BLOCK, planes + 2 * BLOCK, n, &rules[k], level);
        memset(part, 0, sizeof part);
        size_t i = 0;
        for (; i + 4 <= n; i += 4)
            for (int p = 0; p < 4; p++)
                part[p][level[i + p]]++;
        for (; i < n; i++)
            part[0][level[i]]++;
        for (size_t v = 0; v < LEVELS; v++)
            out[k * LEVELS + v] += (uint64_t)part[0][v] + part[1][v] + part[2][v] + part[3][v];
    }
}

/* Grey histograms (m, 256) of pixels, added to `out`. */
void count_pixels_16(const uint16_t *rgb, size_t n, const Rule *rules, size_t m, uint64_t *out)
{
    float planes[3 * BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t length = n - start < BLOCK ? n - start : BLOCK;
        for (size_t i = 0; i < length; i++)
            for (int c = 0; c < 3; c++)
                planes[c * BLOCK + i] = rgb[3 * (start + i) + c];
        count_block(planes, length, rules, m, out);
    }
}

#define WEIGH_LOOP                                                      \
    const Rule local = *rule;                                           \
    for (size_t i = 0; i < n; i++)                                      \
        out[i] = (uint8_t)level_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2], &local);

typedef void Weigh(const uint8_t *restrict rgb, size_t n, const Rule *rule, uint8_t *restrict out);

static Weigh weigh_plain, *weigh = weigh_plain;

static void weigh_plain(const uint8_t *restrict rgb, size_t n, const Rule *rule, uint8_t *restrict out)
{
    WEIGH_LOOP
}

#ifdef __x86_64__
__attribute__((target("avx2,fma"))) static void weigh_avx2(const uint8_t *restrict rgb, size_t n,
                                                           const Rule *rule, uint8_t *restrict out)
{
    WEIGH_LOOP
}
#endif

/* Grey levels of pixels. */
void weigh_8(const uint8_t *rgb, size_t n, const Rule *rule, uint8_t *out)
{
    weigh(rgb, n, rule, out);
}

/* Below, every operation is rounded on its own, so that all processors come to the same bits. */
#pragma STDC FP_CONTRACT OFF

enum { REACH = 3, SIDE = 8, PRODUCTS = 6, SUMS = PRODUCTS + 2 };

/* Rows lie `row` bytes apart; values are of two bytes if `wide`, else of one. */
typedef struct {
    const void *rgb;
    size_t row, wide, height, width;
} Tile;

/* The two Gaussians of a band, from their middles outwards, and the values of its brightest channel between which a
 * pixel counts. */
typedef struct {
    float fine[REACH + 1], coarse[REACH + 1], least, most;
} Band;

/* The values of a tile as planes (3, height, width). */
ALWAYS_INLINE void planes_of(const Tile *tile, float *restrict planes)
{
    size_t n = tile->height * tile->width;
    for (size_t y = 0; y < tile->height; y++) {
        const uint8_t *restrict p = (const uint8_t *)tile->rgb + y * tile->row;
        const uint16_t *restrict q = (const void *)p;
        float *restrict r = planes + y * tile->width, *restrict g = r + n, *restrict b = g + n;
        if (tile->wide)
            for (size_t x = 0; x < tile->width; x++)
                r[x] = q[3 * x], g[x] = q[3 * x + 1], b[x] = q[3 * x + 2];
        else
            for (size_t x = 0; x < tile->width; x++)
                r[x] = p[3 * x], g[x] = p[3 * x + 1], b[x] = p[3 * x + 2];
    }
}

/* The sums of 2x2 pixels of planes (3, height, width), in their place: (3, height / 2, width / 2). */
ALWAYS_INLINE void halve(float *planes, size_t height, size_t width)
{
    float *out = planes;
    for (size_t c = 0; c < 3; c++)
        for (size_t y = 0; y < height / 2; y++) {
            const float *p = planes + (c * height + 2 * y) * width, *below = p + width;
            for (size_t x = 0; x < width / 2; x++)
                *out++ = (p[2 * x] + p[2 * x + 1]) + (below[2 * x] + below[2 * x + 1]);
        }
}

/* A Gaussian along rows (step 1) or columns (step: the width). Returns what is left of n: what belongs to i + REACH
 * step is at i. Rows stay as wide, and their ends mean nothing. */
ALWAYS_INLINE size_t smooth(const float *restrict in, size_t step, size_t n, const float *taps,
                            float *restrict out)
{
    const float t0 = taps[0], t1 = taps[1], t2 = taps[2], t3 = taps[3];
    n -= 2 * REACH * step;
    for (size_t i = 0; i < n; i++) {
        const float *p = in + i;
        out[i] = (t0 * p[3 * step] + t1 * (p[2 * step] + p[4 * step])) +
                 (t2 * (p[step] + p[5 * step]) + t3 * (p[0] + p[6 * step]));
    }
    return n;
}

/* The bands of three planes of n, in their place; what belongs to a pixel comes 2 REACH rows and columns before it.
 * `other` and `fine` are scratch of n. Returns what is left of n. */
ALWAYS_INLINE size_t bands_of(float *planes, size_t n, size_t width, const Band *band, float *restrict other,
                              float *restrict fine)
{
    size_t left = 0;
    for (size_t c = 0; c < 3; c++) {
        float *restrict plane = planes + c * n;
        left = smooth(plane, 1, n, band->fine, other);
        left = smooth(other, width, left, band->fine, fine);
        left = smooth(fine, 1, left, band->coarse, other);
        left = smooth(other, width, left, band->coarse, plane);
        for (size_t i = 0; i < left; i++)
            plane[i] = fine[i + REACH * (width + 1)] - plane[i];
    }
    return left;
}

/* Of three planes of n, 1 where a pixel counts, else 0. */
ALWAYS_INLINE void exposed(const float *restrict r, size_t n, const Band *band, float *restrict out)
{
    const float *restrict g = r + n, *restrict b = g + n, least = band->least, most = band->most;
    for (size_t i = 0; i < n; i++) {
        float brighter = r[i] > g[i] ? r[i] : g[i], brightest = brighter > b[i] ? brighter : b[i];
        out[i] = (float)((brightest >= least) & (brightest <= most));
    }
}

/* The least of 2 REACH + 1 values, laid out as by `smooth`. */
ALWAYS_INLINE size_t erode(const float *restrict in, size_t step, size_t n, float *restrict out)
{
    n -= 2 * REACH * step;
    for (size_t i = 0; i < n; i++) {
        float least = in[i];
        for (size_t k = 1; k <= 2 * REACH; k++)
            least = in[i + k * step] < least ? in[i + k * step] : least;
        out[i] = least;
    }
    return n;
}

/* By column over some rows, the sums of the products RR, GG, BB, RG, RB, GB of planes n apart, of `level`, and of
 * `counts`: (SUMS, width). */
ALWAYS_INLINE void sum_rows(const float *planes, size_t n, const float *level, const float *counts, size_t rows,
                            size_t width, float *restrict sums)
{
    static const size_t one[PRODUCTS] = {0, 1, 2, 0, 0, 1}, other[PRODUCTS] = {0, 1, 2, 1, 2, 2};
    memset(sums, 0, SUMS * width * sizeof *sums);
    for (size_t y = 0; y < rows; y++) {
        for (size_t k = 0; k < PRODUCTS; k++) {
            const float *p = planes + one[k] * n + y * width, *q = planes + other[k] * n + y * width;
            float *restrict sum = sums + k * width;
            for (size_t x = 0; x < width; x++)
                sum[x] += p[x] * q[x];
        }
        for (size_t x = 0; x < width; x++) {
            sums[PRODUCTS * width + x] += level[y * width + x];
            sums[(PRODUCTS + 1) * width + x] += counts[y * width + x];
        }
    }
}

ALWAYS_INLINE void detail_of(const Tile *tile, const Band *band, float *scratch, double *out)
{
    planes_of(tile, scratch);
    halve(scratch, tile->height, tile->width);
    size_t width = tile->width / 2, height = tile->height / 2 - 4 * REACH, n = tile->height / 2 * width;
    float *counts = scratch + 3 * n, *other = counts + n, *fine = other + n, *sums = fine + n;
    exposed(scratch, n, band, counts);
    erode(other, width, erode(counts, 1, n, other), counts);
    size_t left = bands_of(scratch, n, width, band, other, fine);
    counts += REACH * (width + 1);
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < left; i++)
            scratch[c * n + i] *= counts[i];
    for (size_t y = 0; y < height; y += SIDE) {
        const float *kept = scratch + y * width, *beside = counts + y * width;
        sum_rows(kept, n, beside, beside, height - y < SIDE ? height - y : SIDE, width, sums);
        for (size_t x = 0; x < width - 4 * REACH; x++)
            for (size_t k = 0; k < SUMS; k++)
                out[k] += (double)sums[k * width + x];
    }
}

ALWAYS_INLINE void blocks_of(const Tile *tile, const Band *band, float *scratch, float *out)
{
    size_t width = tile->width, n = tile->height * width, across = (width - 4 * REACH) / SIDE;
    float *counts = scratch + 3 * n, *level = counts + n, *other = level + n, *fine = other + n, *sums = fine + n;
    planes_of(tile, scratch);
    exposed(scratch, n, band, counts);
    for (size_t i = 0; i < n; i++)
        level[i] = scratch[i] + scratch[n + i] + scratch[2 * n + i];
    bands_of(scratch, n, width, band, other, fine);
    size_t first = 2 * REACH * (width + 1), last = (tile->height - 4 * REACH) / SIDE * SIDE * width;
    for (size_t y = 0; y < last; y += SIDE * width) {
        sum_rows(scratch + y, n, level + first + y, counts + first + y, SIDE, width, sums);
        for (size_t x = 0; x < across * SIDE; x += SIDE)
            for (size_t k = 0; k < SUMS; k++) {
                float sum = 0;
                for (size_t i = 0; i < SIDE; i++)
                    sum += sums[k * width + x + i];
                *out++ = sum;
            }
    }
}

typedef void Measure(const Tile *tile, const Band *band, float *scratch, void *out);

static Measure detail_plain, blocks_plain, *detail = detail_plain, *blocks = blocks_plain;

static void detail_plain(const Tile *tile, const Band *band, float *scratch, void *out)
{
    detail_of(tile, band, scratch, out);
}

static void blocks_plain(const Tile *tile, const Band *band, float *scratch, void *out)
{
    blocks_of(tile, band, scratch, out);
}

/* Of the band of a tile at half its size, added to `out` (SUMS): the sums of its products, and twice how many pixels
 * they are of. A pixel counts with all in REACH of it. 4 REACH pixels around are taken for their values alone.
 * `scratch`: (8, height, width). */
void measure_detail(const void *rgb, size_t row, size_t wide, size_t height, size_t width, const Band *band,
                    float *scratch, double *out)
{
    detail(&(Tile){rgb, row, wide, height, width}, band, scratch, out);
}

/* Of the band of a tile, for each block of SIDE x SIDE pixels the sums of its products and of its values, and how many
 * pixels count: `out` (blocks, SUMS). 2 REACH pixels around are taken for their values alone.
 * `scratch`: (8, height, width). */
void measure_blocks(const void *rgb, size_t row, size_t wide, size_t height, size_t width, const Band *band,
                    float *scratch, float *out)
{
    blocks(&(Tile){rgb, row, wide, height, width}, band, scratch, out);
}

#ifdef __x86_64__
__attribute__((target("avx2"))) static void detail_avx2(const Tile *tile, const Band *band, float *scratch,
                                                        void *out)
{
    detail_of(tile, band, scratch, out);
}

__attribute__((target("avx2"))) static void blocks_avx2(const Tile *tile, const Band *band, float *scratch,
                                                        void *out)
{
    blocks_of(tile, band, scratch, out);
}

/* The processor and the system both have to know the wide registers. */
__attribute__((constructor)) static void choose(void)
{
    unsigned a, b, c, d, saved;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & bit_OSXSAVE) == 0 || (c & bit_FMA) == 0)
        return;
    __asm__("xgetbv" : "=a"(saved), "=d"(d) : "c"(0));
    if ((saved & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2)) {
        levels = levels_avx2;
        places_of = places_avx2;
        weigh = weigh_avx2;
        detail = detail_avx2;
        blocks = blocks_avx2;
    }
}
#endif
