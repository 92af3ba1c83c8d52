/* Histograms of uniform, rotation-invariant local binary patterns (LBP).
 *
 * Ojala, Pietikainen, Maenpaa (2002), IEEE TPAMI 24(7). The numbers are those of scikit-image's
 * `local_binary_pattern(..., method="uniform")`, so the arithmetic is too: double precision, a
 * sampling point's fractions taken from its position in the picture, weights applied along the
 * row first. Where a point's value and the centre are equal but for rounding, that rounding
 * decides whether the point counts as set; so nothing here may be rearranged.
 *
 * What is saved against the textbook loop: interpolation along a row is done once for all points
 * with the same column offset and for both rows that need it; an offset of whole pixels takes
 * none; what is worked on stays in the nearest cache; no picture of codes is stored. */
#ifndef TOKT_LBP_H
#define TOKT_LBP_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum {
    LBP_ROWS = 32,    /* rows and columns of pixels that are worked on at a time, at most: */
    LBP_COLUMNS = 64, /* what is computed from them then fits the nearest cache */
    LBP_MOST_POINTS = 64,
    LBP_LANES = 8     /* rows of scratch begin where a cache line does */
};

/* The sampling points. Offsets are in pixels from the centre; a fraction is what is left of
 * position + offset above the next lower whole pixel. Points are grouped by column offset. */
typedef struct {
    int points;
    int columns;                   /* distinct column offsets */
    int reach;                     /* whole pixels that any point reads beyond the centre */
    const int *first;              /* [columns + 1] where a column offset's points begin in: */
    const int *point;              /* [points] the point's place on the circle */
    const int *row_floor;          /* [points] by place on the circle */
    const double *row_fraction;    /* [points][height] by place on the circle */
    const int *column_floor;       /* [columns] */
    const double *column_fraction; /* [columns][width] */
    const uint8_t *code;           /* [2^points] a pattern's bin, or NULL where they are many */
} LbpPoints;

/* The pixels that may be read: a patch, or the whole picture. Beyond them all is zero. */
typedef struct {
    const uint8_t *pixels;
    ptrdiff_t stride; /* bytes from row to row */
    int height, width;
} LbpView;

/* A block of the view: its first row and column and its size. */
typedef struct {
    int row, column, height, width;
} LbpBlock;

/* What is computed from a block. Rows of `padded` values; a row more at the end stays zero. */
typedef struct {
    int padded;      /* width of the block, rounded up to LBP_LANES */
    int first, last; /* rows of the block's surroundings that lie in the view */
    double *across;  /* the surroundings' rows, interpolated at one column offset */
    double *centre;  /* the block's pixels */
    int64_t *bits;   /* for each pixel of the block one bit a point */
    double *source;  /* the surroundings' pixels, `padded` + 2 reach in a row */
    double *left, *right; /* weights along the row */
} LbpScratch;

TOKT_BODY int lbp_padded(int width) { return (width + LBP_LANES - 1) & ~(LBP_LANES - 1); }

TOKT_BODY int lbp_at_most(int size, int most) { return size < most ? size : most; }

/* Doubles that a patch of this size needs as scratch. */
static size_t lbp_scratch(const LbpPoints *points, int height, int width) {
    size_t high = lbp_at_most(height, LBP_ROWS), wide = lbp_padded(lbp_at_most(width, LBP_COLUMNS));
    size_t around = high + 2 * (size_t)points->reach;
    return (around + 1 + 2 * high + 2) * wide + around * (wide + 2 * points->reach) + LBP_LANES;
}

static void lbp_lay_out(const LbpPoints *points, const LbpView *view, const LbpBlock *block,
                        double *memory, LbpScratch *scratch) {
    int reach = points->reach, around = block->height + 2 * reach;
    int padded = scratch->padded = lbp_padded(block->width);
    scratch->first = reach - lbp_at_most(block->row, reach);
    scratch->last = lbp_at_most(around, view->height - block->row + reach);
    scratch->across = (double *)(((uintptr_t)memory + 63) & ~(uintptr_t)63);
    scratch->centre = scratch->across + (size_t)(around + 1) * padded;
    scratch->bits = (int64_t *)(scratch->centre + (size_t)block->height * padded);
    scratch->left = scratch->centre + 2 * (size_t)block->height * padded;
    scratch->right = scratch->left + padded;
    scratch->source = scratch->right + padded;
}

/* The block, and what lies around it, as doubles, zero to the sides of the view. */
TOKT_BODY void lbp_load(const LbpView *view, const LbpBlock *block, int reach,
                        const LbpScratch *scratch) {
    int width = scratch->padded + 2 * reach, begin = lbp_at_most(block->column, reach);
    int end = lbp_at_most(block->width + reach, view->width - block->column);
    for (int row = scratch->first; row < scratch->last; row++) {
        const uint8_t *TOKT_RESTRICT in =
            view->pixels + (block->row - reach + row) * view->stride + block->column;
        double *TOKT_RESTRICT out = scratch->source + (size_t)row * width;
        for (int x = 0; x < reach - begin; x++) out[x] = 0;
        for (int x = -begin; x < end; x++) out[x + reach] = in[x];
        for (int x = reach + end; x < width; x++) out[x] = 0;
    }
    for (int row = 0; row < block->height; row++)
        memcpy(scratch->centre + (size_t)row * scratch->padded,
               scratch->source + (size_t)(row + reach) * width + reach,
               scratch->padded * sizeof(double));
}

/* Interpolate the rows that lie in the view at one column offset. */
TOKT_BODY void lbp_along_rows(const LbpPoints *points, const LbpBlock *block, int view_width,
                              int offset, const LbpScratch *scratch) {
    int padded = scratch->padded & -LBP_LANES, width = padded + 2 * points->reach;
    const double *fraction = points->column_fraction + (size_t)offset * view_width + block->column;
    double *TOKT_RESTRICT left = scratch->left, *TOKT_RESTRICT right = scratch->right;
    for (int x = 0; x < padded; x++) right[x] = x < block->width ? fraction[x] : 0;
    int whole = 1;
    for (int x = 0; x < padded; x++) {
        left[x] = 1 - right[x];
        whole &= right[x] == 0;
    }
    for (int row = scratch->first; row < scratch->last; row++) {
        const double *TOKT_RESTRICT at =
            scratch->source + (size_t)row * width + points->reach + points->column_floor[offset];
        double *TOKT_RESTRICT out = scratch->across + (size_t)row * padded;
        if (whole)
            for (int x = 0; x < padded; x++) out[x] = at[x];
        else
            for (int x = 0; x < padded; x++) out[x] = left[x] * at[x] + right[x] * at[x + 1];
    }
}

/* Set one point's bit in every pixel of the block that is not above its value. */
TOKT_BODY void lbp_set_bits(const LbpPoints *points, const LbpView *view, const LbpBlock *block,
                            int point, const LbpScratch *scratch) {
    int padded = scratch->padded & -LBP_LANES, above = points->reach + points->row_floor[point];
    const double *beyond = scratch->across + (size_t)(block->height + 2 * points->reach) * padded;
    const double *fraction = points->row_fraction + (size_t)point * view->height + block->row;
    int64_t bit = (int64_t)((uint64_t)1 << point);
    for (int row = 0; row < block->height; row++, above++) {
        int in = scratch->first <= above && above < scratch->last;
        int next_in = scratch->first <= above + 1 && above + 1 < scratch->last;
        const double *TOKT_RESTRICT upper = in ? scratch->across + (size_t)above * padded : beyond;
        const double *TOKT_RESTRICT lower =
            next_in ? scratch->across + (size_t)(above + 1) * padded : beyond;
        const double *TOKT_RESTRICT centre = scratch->centre + (size_t)row * padded;
        int64_t *TOKT_RESTRICT bits = scratch->bits + (size_t)row * padded;
        double below = fraction[row], rest = 1 - below;
        if (below == 0)
            for (int x = 0; x < padded; x++) bits[x] |= upper[x] >= centre[x] ? bit : 0;
        else
            for (int x = 0; x < padded; x++)
                bits[x] |= rest * upper[x] + below * lower[x] >= centre[x] ? bit : 0;
    }
}

TOKT_BODY int lbp_ones(uint64_t word) {
#if defined(__GNUC__)
    return __builtin_popcountll(word);
#else
    int ones = 0;
    for (; word; word &= word - 1) ones++;
    return ones;
#endif
}

/* Add the block's patterns to the histogram: a uniform one by its number of ones, any other
 * last. Changes are counted between neighbours on the open chain of points, not around it.
 * Without a branch, because which patterns are uniform cannot be foreseen; and into two sets of
 * counts in turn, because neighbours often have the same pattern. */
TOKT_BODY void lbp_count(const LbpPoints *points, const LbpBlock *block, const LbpScratch *scratch,
                         int64_t *histogram) {
    uint64_t chain = ((uint64_t)1 << (points->points - 1)) - 1;
    const uint8_t *code = points->code;
    uint32_t counts[2][2][LBP_MOST_POINTS + 2];
    memset(counts, 0, sizeof counts);
    for (int row = 0; row < block->height; row++) {
        const int64_t *bits = scratch->bits + (size_t)row * scratch->padded;
        for (int x = 0; code && x < block->width; x++) counts[x & 1][0][code[bits[x]]]++;
        for (int x = 0; !code && x < block->width; x++) {
            uint64_t pattern = (uint64_t)bits[x];
            int mixed = lbp_ones((pattern ^ (pattern >> 1)) & chain) > 2;
            counts[x & 1][mixed][lbp_ones(pattern)]++;
        }
    }
    for (int bin = 0; bin <= points->points + 1; bin++) {
        histogram[bin] += counts[0][0][bin] + counts[1][0][bin];
        histogram[points->points + 1] += counts[0][1][bin] + counts[1][1][bin];
    }
}

/* Add the patterns of one block to a histogram of points + 2 bins. */
TOKT_BODY void lbp_block_body(const LbpView *view, const LbpPoints *points, const LbpBlock *block,
                              double *memory, int64_t *histogram) {
    LbpScratch scratch;
    lbp_lay_out(points, view, block, memory, &scratch);
    lbp_load(view, block, points->reach, &scratch);
    size_t row = scratch.padded * sizeof(double);
    memset(scratch.across + (size_t)(block->height + 2 * points->reach) * scratch.padded, 0, row);
    memset(scratch.bits, 0, block->height * row);
    for (int offset = 0; offset < points->columns; offset++) {
        lbp_along_rows(points, block, view->width, offset, &scratch);
        for (int i = points->first[offset]; i < points->first[offset + 1]; i++)
            lbp_set_bits(points, view, block, points->point[i], &scratch);
    }
    lbp_count(points, block, &scratch, histogram);
}

TOKT_VARIANTS(lbp_block,
              (const LbpView *view, const LbpPoints *points, const LbpBlock *block, double *memory,
               int64_t *histogram),
              (view, points, block, memory, histogram))

/* The histogram of one patch, whose first pixel in the view is (row, column). */
static void lbp_patch(const LbpView *view, const LbpPoints *points, const LbpBlock *patch,
                      double *memory, int64_t *histogram) {
    for (int row = 0; row < patch->height; row += LBP_ROWS) {
        for (int column = 0; column < patch->width; column += LBP_COLUMNS) {
            LbpBlock block = {patch->row + row, patch->column + column,
                              lbp_at_most(patch->height - row, LBP_ROWS),
                              lbp_at_most(patch->width - column, LBP_COLUMNS)};
            lbp_block(view, points, &block, memory, histogram);
        }
    }
}

#endif
