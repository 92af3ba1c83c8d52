/* Haralick's first 13 features from grey-level co-occurrence matrices (GLCM).
 *
 * Haralick, Shanmugam, Dinstein (1973), IEEE TSMC 3(6), as mahotas reads it: symmetric counts,
 * base-2 logarithms, feature 10 the variance over the (largest grey level + 1) values of P(|i-j|).
 * The matrix is symmetric, so both marginals are one, and with them HXY1 = HXY2 = 2 HX.
 *
 * Sparse: a patch has far fewer pairs of neighbours than a matrix has cells, so only the cells
 * that a pair fell into are visited, and the cost is bound by the patch's pixels. Everything up
 * to the logarithms is summed in whole numbers, variances around a whole number next to the mean,
 * so that a bright, nearly constant patch loses no digits. */
#ifndef TOKT_GLCM_H
#define TOKT_GLCM_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { GREYS = 256, DIRECTIONS = 4, HARALICK = 13 };

/* One direction's pairs of neighbours. */
typedef struct {
    uint32_t *count; /* [GREYS * GREYS] by key; all zero between patches */
    uint16_t *cells; /* [GREYS * GREYS] keys that occur, in order of appearance */
    int n_cells;
    int64_t total; /* of the symmetric matrix: each pair counts twice */
} GlcmPairs;

/* Logarithms of whole numbers, base 2: `of[n]` for n < `size`. */
typedef struct {
    const double *of;
    int64_t size;
} GlcmLog2;

/* A patch and what is needed to count in it. */
typedef struct {
    const uint8_t *pixels;
    ptrdiff_t stride; /* bytes from row to row */
    int height, width;
} GlcmPatch;

/* One direction's symmetric matrix, summed along its rows and along its diagonals. */
typedef struct {
    int low, high; /* grey levels between which all counts lie */
    int brightest; /* the patch's brightest grey level */
    int64_t total; /* of all counts */
    int n_off, n_diagonal;
    int32_t off[GREYS * (GREYS - 1) / 2 + 1]; /* counts above the diagonal, as many below it */
    int32_t diagonal[GREYS + 1];              /* counts on it */
    int32_t level[GREYS];
    int32_t difference[GREYS];
    int32_t sum[2 * GREYS];
} GlcmSums;

/* Keys of n pairs: the darker level in the high byte, the brighter one in the low byte. */
TOKT_BODY void glcm_keys_body(const uint8_t *TOKT_RESTRICT first,
                              const uint8_t *TOKT_RESTRICT second, int n,
                              uint16_t *TOKT_RESTRICT keys) {
    for (int x = 0; x < n; x++) {
        uint16_t a = first[x], b = second[x];
        keys[x] = a < b ? (uint16_t)(a << 8 | b) : (uint16_t)(b << 8 | a);
    }
}

TOKT_VARIANTS(glcm_keys,
              (const uint8_t *first, const uint8_t *second, int n, uint16_t *keys),
              (first, second, n, keys))

/* Count one pair; a key that is new is kept by moving past it, without a branch. */
TOKT_BODY int glcm_count(uint32_t *count, uint16_t *cells, int n_cells, uint16_t key) {
    uint32_t before = count[key];
    cells[n_cells] = key;
    count[key] = before + 1;
    return n_cells + (before == 0);
}

/* Count the pairs of all four directions: right, down right, down, down left. They are counted
 * in turn because the same pair often follows itself, and adding to a number that was just
 * written has to wait for it. */
static void glcm_count_patch(const GlcmPatch *patch, uint16_t *keys, GlcmPairs *pairs) {
    int width = patch->width, n[DIRECTIONS] = {0, 0, 0, 0};
    uint16_t *right = keys, *diagonal = keys + width, *down = diagonal + width, *back = down + width;
    for (int y = 0; y < patch->height; y++) {
        const uint8_t *row = patch->pixels + y * patch->stride, *next = row + patch->stride;
        glcm_keys(row, row + 1, width - 1, right);
        if (y == patch->height - 1) {
            for (int x = 0; x < width - 1; x++)
                n[0] = glcm_count(pairs[0].count, pairs[0].cells, n[0], right[x]);
            break;
        }
        glcm_keys(row, next + 1, width - 1, diagonal);
        glcm_keys(row, next, width, down);
        glcm_keys(row + 1, next, width - 1, back);
        for (int x = 0; x < width - 1; x++) {
            n[0] = glcm_count(pairs[0].count, pairs[0].cells, n[0], right[x]);
            n[1] = glcm_count(pairs[1].count, pairs[1].cells, n[1], diagonal[x]);
            n[2] = glcm_count(pairs[2].count, pairs[2].cells, n[2], down[x]);
            n[3] = glcm_count(pairs[3].count, pairs[3].cells, n[3], back[x]);
        }
        n[2] = glcm_count(pairs[2].count, pairs[2].cells, n[2], down[width - 1]);
    }
    int64_t beside = 2 * (int64_t)patch->height * (width - 1), below = patch->height - 1;
    pairs[0].total = beside;
    pairs[1].total = pairs[3].total = 2 * below * (width - 1);
    pairs[2].total = 2 * below * width;
    for (int direction = 0; direction < DIRECTIONS; direction++)
        pairs[direction].n_cells = n[direction];
}

/* Drop the pairs with grey level 0, unless that would leave a direction without any. */
static void glcm_drop_zeros(GlcmPairs *pairs) {
    for (int direction = 0; direction < DIRECTIONS; direction++) {
        int kept = 0;
        for (int i = 0; i < pairs[direction].n_cells; i++)
            kept += pairs[direction].cells[i] >= GREYS;
        if (kept == 0) return;
    }
    for (int direction = 0; direction < DIRECTIONS; direction++) {
        GlcmPairs *one = pairs + direction;
        int kept = 0;
        for (int i = 0; i < one->n_cells; i++) {
            uint16_t key = one->cells[i];
            if (key >= GREYS) {
                one->cells[kept++] = key;
                continue;
            }
            one->total -= 2 * (int64_t)one->count[key];
            one->count[key] = 0;
        }
        one->n_cells = kept;
    }
}

/* n log2(total / n): what n of `total` add to the entropy, times `total`; 0 for none. */
TOKT_BODY double glcm_surprise(int64_t n, int64_t total, double log2_total, GlcmLog2 log2_of) {
    if (2 * n > total) /* nearly all of them: the two logarithms would cancel */
        return -1.4426950408889634 * (double)n * log1p((double)(n - total) / (double)total);
    return (double)n * (log2_total - (n < log2_of.size ? log2_of.of[n] : log2((double)n)));
}

/* Entropy of counts in bits, times `total`. Four sums go side by side: one alone would wait for
 * itself at every addition. */
static double glcm_surprises(const int32_t *counts, int n, int64_t total, double log2_total,
                             GlcmLog2 log2_of) {
    double sums[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int lane = 0; lane < 4; lane++)
            sums[lane] += glcm_surprise(counts[i + lane], total, log2_total, log2_of);
    for (; i < n; i++) sums[0] += glcm_surprise(counts[i], total, log2_total, log2_of);
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

static int64_t glcm_squares(const int32_t *counts, int n) {
    int64_t squares = 0;
    for (int i = 0; i < n; i++) squares += (int64_t)counts[i] * counts[i];
    return squares;
}

/* Sum the matrix up, and set its counts to zero on the way. */
static void glcm_sum(const GlcmPairs *pairs, GlcmSums *sums) {
    int low = sums->low, range = sums->high - low + 1, n_off = 0, n_diagonal = 0;
    memset(sums->level + low, 0, range * sizeof(int32_t));
    memset(sums->difference, 0, range * sizeof(int32_t));
    memset(sums->sum + 2 * low, 0, (2 * range - 1) * sizeof(int32_t));
    for (int i = 0; i < pairs->n_cells; i++) {
        uint16_t key = pairs->cells[i];
        int darker = key >> 8, brighter = key & 255, on = darker == brighter;
        int32_t n = (int32_t)pairs->count[key];
        pairs->count[key] = 0;
        /* Written to both lists, kept in one of them, without a branch. */
        sums->off[n_off] = n;
        sums->diagonal[n_diagonal] = 2 * n;
        n_off += !on;
        n_diagonal += on;
        sums->level[darker] += n;
        sums->level[brighter] += n;
        sums->difference[brighter - darker] += 2 * n;
        sums->sum[brighter + darker] += 2 * n;
    }
    sums->n_off = n_off;
    sums->n_diagonal = n_diagonal;
}

/* Features 1, 9: those of the matrix itself. Returns its entropy in bits. */
static double glcm_of_cells(const GlcmSums *sums, double log2_total, GlcmLog2 log2_of,
                            double *features) {
    int64_t total = sums->total;
    int64_t squares = 2 * glcm_squares(sums->off, sums->n_off) +
                      glcm_squares(sums->diagonal, sums->n_diagonal);
    double surprise = 2 * glcm_surprises(sums->off, sums->n_off, total, log2_total, log2_of) +
                      glcm_surprises(sums->diagonal, sums->n_diagonal, total, log2_total, log2_of);
    features[0] = (double)squares / ((double)total * (double)total);
    features[8] = surprise / (double)total;
    return features[8];
}

/* Features 6, 8: those of the sums' distribution. Returns the sum of all grey levels. */
static int64_t glcm_of_sums(const GlcmSums *sums, double log2_total, GlcmLog2 log2_of,
                            double *features) {
    int first = 2 * sums->low, n = 2 * (sums->high - sums->low) + 1;
    int64_t twice = 0;
    for (int k = first; k < first + n; k++) twice += (int64_t)k * sums->sum[k];
    features[5] = (double)twice / (double)sums->total;
    features[7] = glcm_surprises(sums->sum + first, n, sums->total, log2_total, log2_of) /
                  (double)sums->total;
    return twice / 2;
}

/* Features 2, 5, 10, 11: those of the differences' distribution. Returns the contrast's sum. */
static int64_t glcm_of_differences(const GlcmSums *sums, double log2_total, GlcmLog2 log2_of,
                                   const double *inverse_difference, double *features) {
    int64_t contrast = 0;
    int range = sums->high - sums->low + 1;
    double total = (double)sums->total, homogeneity = 0, spread = 0;
    double values = sums->brightest + 1, mean = 1 / values;
    for (int k = 0; k < range; k++) {
        int32_t n = sums->difference[k];
        double excess = n / total - mean;
        spread += excess * excess;
        contrast += (int64_t)k * k * n;
        homogeneity += n * inverse_difference[k];
    }
    features[1] = (double)contrast / total;
    features[4] = homogeneity / total;
    features[9] = (spread + (values - range) * mean * mean) / values;
    features[10] = glcm_surprises(sums->difference, range, sums->total, log2_total, log2_of) / total;
    return contrast;
}

/* Features 3, 4, 7, from whole numbers; `first` is the sum of all grey levels. Returns the
 * levels' entropy in bits. */
static double glcm_of_levels(const GlcmSums *sums, int64_t first, int64_t contrast,
                             double log2_total, GlcmLog2 log2_of, double *features) {
    int64_t middle = (first + sums->total / 2) / sums->total, spread = 0;
    int low = sums->low, range = sums->high - low + 1;
    double total = (double)sums->total;
    for (int k = low; k < low + range; k++)
        spread += (k - middle) * (k - middle) * sums->level[k];
    /* With c the middle: sum (i + j - 2c)^2 = 4 sum (i - c)^2 - sum (i - j)^2. */
    double shift = (double)(first - middle * sums->total) / total;
    double variance = (double)spread / total - shift * shift;
    double covariance = (double)(2 * spread - contrast) / (2 * total) - shift * shift;
    features[2] = variance == 0 ? 1 : covariance / variance;
    features[3] = variance;
    features[6] = (double)(4 * spread - contrast) / total - 4 * shift * shift;
    return glcm_surprises(sums->level + low, range, sums->total, log2_total, log2_of) / total;
}

/* Add a quarter of one direction's 13 features; leaves the counts at zero. */
static void glcm_features(const GlcmPairs *pairs, GlcmLog2 log2_of, const double *inverse_difference,
                          GlcmSums *sums, double *mean) {
    double features[HARALICK], log2_total = log2((double)pairs->total);
    sums->total = pairs->total;
    glcm_sum(pairs, sums);
    double entropy = glcm_of_cells(sums, log2_total, log2_of, features);
    int64_t first = glcm_of_sums(sums, log2_total, log2_of, features);
    int64_t contrast =
        glcm_of_differences(sums, log2_total, log2_of, inverse_difference, features);
    double levels = glcm_of_levels(sums, first, contrast, log2_total, log2_of, features);
    double shared = 2 * levels - entropy; /* what one level tells about the other, bits */
    features[11] = levels == 0 ? 0 : -shared / levels;
    features[12] = shared > 0 ? sqrt(-expm1(-2 * shared)) : 0;
    for (int i = 0; i < HARALICK; i++) mean[i] += features[i] / DIRECTIONS;
}

/* The 13 features of a patch, mean over the four directions. */
static void glcm_patch(const GlcmPatch *patch, int ignore_zeros, GlcmLog2 log2_of,
                       const double *inverse_difference, uint16_t *keys, GlcmPairs *pairs,
                       GlcmSums *sums, double *mean) {
    uint8_t low = 255, high = 0;
    for (int y = 0; y < patch->height; y++) {
        const uint8_t *row = patch->pixels + y * patch->stride;
        for (int x = 0; x < patch->width; x++) {
            low = row[x] < low ? row[x] : low;
            high = row[x] > high ? row[x] : high;
        }
    }
    glcm_count_patch(patch, keys, pairs);
    if (ignore_zeros) glcm_drop_zeros(pairs);
    sums->low = low;
    sums->high = sums->brightest = high;
    memset(mean, 0, HARALICK * sizeof(double));
    for (int direction = 0; direction < DIRECTIONS; direction++)
        glcm_features(pairs + direction, log2_of, inverse_difference, sums, mean);
}

#endif
