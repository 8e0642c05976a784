/* The inner loops of the grey room. What each must do is said, and checked against NumPy, in Python: see
 * kernels.py and its tests. No allocation and no threads: every call works on its caller's arrays. */

#include <stddef.h>
#include <stdint.h>
#include <string.h>
#ifdef __x86_64__
#include <cpuid.h>
#endif

#define ALWAYS_INLINE __attribute__((always_inline)) static inline

enum { LEVELS = 256, BLOCK = 2048, CODES = 256 };

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

/* The processor and the system both have to know the wide registers. */
__attribute__((constructor)) static void choose_levels(void)
{
    unsigned a, b, c, d, saved;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & bit_OSXSAVE) == 0 || (c & bit_FMA) == 0)
        return;
    __asm__("xgetbv" : "=a"(saved), "=d"(d) : "c"(0));
    if ((saved & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2))
        levels = levels_avx2;
}
#endif

/* A table ordered by R-G, B-G, G: the colours of a photograph lie close together in it. */
static inline uint32_t place_of(uint8_t r, uint8_t g, uint8_t b)
{
    return (uint32_t)(uint8_t)(r - g) << 16 | (uint32_t)(uint8_t)(b - g) << 8 | g;
}

#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
#define WORD_RED(word) (word & 255)
#define WORD_GREEN(word) (word >> 8 & 255)
#define WORD_BLUE(word) (word >> 16 & 255)
#else
#define WORD_RED(word) (word >> 24)
#define WORD_GREEN(word) (word >> 16 & 255)
#define WORD_BLUE(word) (word >> 8 & 255)
#endif

static void add_places(const uint32_t *places, size_t n, uint32_t *counts)
{
    size_t half = n / 2; /* neighbours often share a colour, and one addition would wait for the other */
    for (size_t i = 0; i < half; i++) {
        counts[places[i]]++;
        counts[places[i + half]]++;
    }
    if (n & 1)
        counts[places[n - 1]]++;
}

void count_colours_8(const uint8_t *rgb, size_t n, uint32_t *counts)
{
    uint32_t places[BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t m = n - start < BLOCK ? n - start : BLOCK;
        const uint8_t *p = rgb + 3 * start;
        size_t last = m - (start + m == n); /* four bytes at a time, which the last pixel has not got */
        for (size_t i = 0; i < last; i++) {
            uint32_t word;
            memcpy(&word, p + 3 * i, 4);
            places[i] = place_of(WORD_RED(word), WORD_GREEN(word), WORD_BLUE(word));
        }
        if (last < m)
            places[last] = place_of(p[3 * last], p[3 * last + 1], p[3 * last + 2]);
        add_places(places, m, counts);
    }
}

void count_colours_16(const uint16_t *rgb, size_t n, const uint8_t *code, uint32_t *counts)
{
    uint32_t places[BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t m = n - start < BLOCK ? n - start : BLOCK;
        const uint16_t *p = rgb + 3 * start;
        for (size_t i = 0; i < m; i++)
            places[i] = place_of(code[p[3 * i]], code[p[3 * i + 1]], code[p[3 * i + 2]]);
        add_places(places, m, counts);
    }
}

static uint32_t spread(uint32_t v)
{
    uint32_t s = 0;
    for (int bit = 0; bit < 8; bit++)
        s |= (v >> bit & 1) << 3 * bit;
    return s;
}

/* The occupied places of `counts`, each as key << 24 | place, or how many there are where `out` is NULL. The key is
 * the codes of R, G, B with their bits interleaved: sorted keys run through cubes within cubes. */
size_t occupied(const uint32_t *counts, uint64_t *out)
{
    enum { STRIDE = 16 };
    uint32_t wide[CODES];
    for (uint32_t v = 0; v < CODES; v++)
        wide[v] = spread(v);
    size_t found = 0;
    for (uint32_t start = 0; start < 1u << 24; start += STRIDE) {
        uint32_t any = 0;
        for (uint32_t i = 0; i < STRIDE; i++)
            any |= counts[start + i];
        if (!any)
            continue;
        for (uint32_t place = start; place < start + STRIDE; place++) {
            if (!counts[place])
                continue;
            if (out) {
                uint32_t g = place & 255, r = (uint8_t)((place >> 16) + g), b = (uint8_t)((place >> 8) + g);
                out[found] = (uint64_t)(wide[r] << 2 | wide[g] << 1 | wide[b]) << 24 | place;
            }
            found++;
        }
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

/* Places in the order of their keys, gathered in cubes of 2^bits codes; those heavier than `heavy` come apart.
 * Writes the codes and mass of the heavy ones from the front, and the least and greatest codes and mass of the
 * cubes from the back of planes of `n` each. Returns how many heavy ones, and how many cubes in `cubes`. */
size_t gather(const uint64_t *keys, size_t n, const uint64_t *masses, uint32_t bits, uint64_t heavy,
              uint8_t *low, uint8_t *high, uint64_t *mass, size_t *cubes)
{
    size_t front = 0, back = n;
    uint64_t open_cube = UINT64_MAX;
    for (size_t i = 0; i < n; i++) {
        uint64_t cube = keys[i] >> 24 >> 3 * bits;
        uint8_t g = (uint8_t)keys[i];
        uint8_t code[3] = {(uint8_t)((keys[i] >> 16) + g), g, (uint8_t)((keys[i] >> 8) + g)};
        if (masses[i] > heavy || cube != open_cube) {
            size_t at = masses[i] > heavy ? front++ : --back;
            for (int c = 0; c < 3; c++)
                low[c * n + at] = high[c * n + at] = code[c];
            mass[at] = masses[i];
            if (masses[i] <= heavy)
                open_cube = cube;
            continue;
        }
        for (int c = 0; c < 3; c++) {
            if (code[c] < low[c * n + back])
                low[c * n + back] = code[c];
            if (code[c] > high[c * n + back])
                high[c * n + back] = code[c];
        }
        mass[back] += masses[i];
    }
    *cubes = n - back;
    return front;
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

/* Grey histograms (rules, 256) of boxes of one colour each. */
void count_boxes(const float *planes, const uint64_t *mass, size_t n, const Rule *rules, size_t m,
                 uint64_t *out)
{
    uint8_t level[BLOCK];
    uint16_t at[BLOCK];
    for (size_t start = 0; start < n; start += BLOCK) {
        size_t length = n - start < BLOCK ? n - start : BLOCK;
        for (size_t k = 0; k < m; k++) {
            const float *r = planes + start;
            levels(r, r + n, r + 2 * n, length, &rules[k], level);
            for (size_t i = 0; i < length; i++)
                at[i] = level[i];
            add_masses(at, mass + start, length, out + k * LEVELS);
        }
    }
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

/* A lower bound of the sum of squared counts for each rule, and the sum for an even spread: (m) each. `known`
 * are counts (m, 256) of colours that are in no box. `runs` is scratch, (256, 256). */
void bound_boxes(const float *low, const float *high, const uint64_t *mass, size_t n, const Rule *rules,
                 size_t m, const uint64_t *known, uint64_t *runs, double *bound, double *even)
{
    for (size_t k = 0; k < m; k++) {
        memcpy(runs, known + k * LEVELS, LEVELS * sizeof *runs);
        uint32_t longest = runs_of(low, high, mass, n, &rules[k], runs);
        double price[LEVELS + 1] = {0}, least[LEVELS], dual = 0, square = 0;
        for (uint32_t extra = 0; extra <= longest; extra++)
            for (uint32_t first = 0; first + extra < LEVELS; first++) {
                double share = (double)runs[extra * LEVELS + first] / (extra + 1);
                price[first] += share;
                price[first + extra + 1] -= share;
            }
        for (uint32_t level = 1; level < LEVELS; level++)
            price[level] += price[level - 1];
        memcpy(least, price, sizeof least);
        for (uint32_t extra = 0; extra <= longest; extra++)
            for (uint32_t first = 0; first + extra < LEVELS; first++) {
                least[first] = price[first + extra] < least[first] ? price[first + extra] : least[first];
                dual += (double)runs[extra * LEVELS + first] * least[first];
            }
        for (uint32_t level = 0; level < LEVELS; level++)
            square += price[level] * price[level];
        bound[k] = 2 * dual - square;
        even[k] = square;
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

/* Grey levels of pixels. */
void weigh_8(const uint8_t *restrict rgb, size_t n, const Rule *rule, uint8_t *restrict out)
{
    const Rule local = *rule;
    for (size_t i = 0; i < n; i++)
        out[i] = (uint8_t)level_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2], &local);
}
