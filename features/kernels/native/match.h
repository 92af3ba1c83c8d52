/* Block matching of two rectified views: for each pixel of the left view the disparity at which
 * the sum of absolute differences over a block is least.
 *
 * The integers of OpenCV's StereoBM. What it costs is the sums: one for each pixel and disparity.
 * They are kept for whole columns of a block and all disparities at once, so that a pixel adds one
 * column and takes one away, 16 bits each, of which a processor does many at a time. Columns and
 * blocks are brought on only where a pixel is wanted:
 *
 *        x-half-1   x+half          columns[x][e] = sum over the block's rows of |left(x) -
 *          | |-------|              right(x - disparity)|, where disparity = largest - e
 *          - |   x   | +            sums[e] of pixel x = columns of x-half .. x+half
 */
#ifndef TOKT_MATCH_H
#define TOKT_MATCH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { MATCH_LANES = 16, MATCH_SHIFT = 4 /* disparities are in 1/16 pixel */ };

typedef struct {
    int smallest, count; /* disparities: smallest .. smallest + count - 1, a multiple of LANES */
    int block;           /* odd */
    int zero;            /* the level of a pixel without any gradient */
    int texture;         /* least sum of differences from `zero` over a block */
    int uniqueness;      /* percent by which all other sums must be larger */
} MatchSettings;

/* Views after the gradient filter, and which pixels of the left one to match; `wanted` may only
 * have pixels whose block, moved by any disparity, lies inside both views. */
typedef struct {
    const uint8_t *left, *right, *wanted;
    int width;
    int top, bottom, first, last; /* rows and columns around what is wanted, ends excluded */
} MatchViews;

/* One column of blocks: the row its sums are those of, and its texture. */
typedef struct {
    int32_t row, texture;
} MatchColumn;

/* Uint16 values that `match_views` needs as scratch for that many columns. */
static size_t match_scratch(const MatchSettings *settings, int width) {
    size_t columns = (size_t)(width + settings->block);
    return columns * (settings->count + sizeof(MatchColumn) / 2) + 2 * settings->count;
}

TOKT_BODY int match_distance(int one, int two) { return one > two ? one - two : two - one; }

/* The same in bytes, of which a processor takes more at a time. */
TOKT_BODY uint8_t match_bytes(uint8_t one, uint8_t two) {
    uint8_t high = one > two ? one : two, low = one > two ? two : one;
    return (uint8_t)(high - low);
}

/* Add a row of the views to a column's sums. */
TOKT_BODY void match_add(const MatchViews *views, const MatchSettings *settings, int row, int x,
                         MatchColumn *column, uint16_t *TOKT_RESTRICT sums) {
    int count = settings->count & -MATCH_LANES, largest = settings->smallest + count - 1;
    size_t at = (size_t)row * views->width + x;
    const uint8_t *TOKT_RESTRICT there = views->right + at - largest;
    uint8_t here = views->left[at];
    column->texture += match_distance(here, settings->zero);
    for (int e = 0; e < count; e++) sums[e] += match_bytes(here, there[e]);
}

/* Add a row of the views to a column's sums, and take another away. */
TOKT_BODY void match_replace(const MatchViews *views, const MatchSettings *settings, int enter,
                             int leave, int x, MatchColumn *column,
                             uint16_t *TOKT_RESTRICT sums) {
    int count = settings->count & -MATCH_LANES, largest = settings->smallest + count - 1;
    size_t at = (size_t)enter * views->width + x, before = (size_t)leave * views->width + x;
    const uint8_t *TOKT_RESTRICT there = views->right + at - largest;
    const uint8_t *TOKT_RESTRICT old_there = views->right + before - largest;
    uint8_t here = views->left[at], old_here = views->left[before];
    column->texture += match_distance(here, settings->zero);
    column->texture -= match_distance(old_here, settings->zero);
    for (int e = 0; e < count; e++)
        sums[e] += (uint16_t)(match_bytes(here, there[e]) - match_bytes(old_here, old_there[e]));
}

/* Bring a column's sums to the block around `row`: on from where they are, or anew. */
TOKT_BODY void match_column(const MatchViews *views, const MatchSettings *settings, int row, int x,
                            MatchColumn *column, uint16_t *sums) {
    int half = settings->block / 2;
    if (row - column->row <= half) {
        for (; column->row < row; column->row++)
            match_replace(views, settings, column->row + half + 1, column->row - half, x, column,
                          sums);
        return;
    }
    column->row = row, column->texture = 0;
    memset(sums, 0, settings->count * sizeof *sums);
    for (int y = row - half; y <= row + half; y++)
        match_add(views, settings, y, x, column, sums);
}

/* Where the least sum is first. */
TOKT_BODY int match_place(const uint16_t *TOKT_RESTRICT sums, const uint16_t *TOKT_RESTRICT order,
                          int count, uint16_t least) {
    uint16_t first = UINT16_MAX;
    for (int e = 0; e < count; e++) {
        uint16_t found = (uint16_t)(order[e] | (uint16_t)-(sums[e] != least));
        first = found < first ? found : first;
    }
    return first;
}

/* How many sums are at most `percent` above the least one, it and its neighbours left out. */
TOKT_BODY int match_rivals(const uint16_t *TOKT_RESTRICT sums, int count, int place, int percent) {
    int limit = sums[place] + sums[place] * percent / 100;
    uint16_t top = limit < UINT16_MAX ? (uint16_t)limit : UINT16_MAX, rivals = 0;
    for (int e = 0; e < count; e++) rivals = (uint16_t)(rivals + (sums[e] <= top));
    for (int e = place - 1; e <= place + 1; e++)
        if (e >= 0 && e < count) rivals = (uint16_t)(rivals - (sums[e] <= top));
    return rivals;
}

/* Disparity in 1/16 pixel of the parabola through the least sum and its neighbours. */
TOKT_BODY int16_t match_between(const uint16_t *sums, int count, int place, int smallest) {
    int after = sums[place + 1 < count ? place + 1 : count - 2];
    int before = sums[place > 0 ? place - 1 : 1];
    int curve = after + before - 2 * sums[place] + match_distance(after, before);
    int part = curve ? (after - before) * 256 / curve : 0;
    return (int16_t)(((count - place - 1 + smallest) * 256 + part + 15) >> (8 - MATCH_SHIFT));
}

/* The sums of a block, and the columns that they are of. */
typedef struct {
    uint16_t *columns, *block;
    const uint16_t *order; /* 0, 1, 2 ... */
    MatchColumn *states;
} MatchSums;

/* The sums of the block around pixel x, from those around `from` or, where that is farther than
 * half a block, anew; the least of them. */
TOKT_BODY uint16_t match_block(const MatchViews *views, const MatchSettings *settings,
                               const MatchSums *sums, int row, int from, int x, int32_t *texture) {
    int count = settings->count & -MATCH_LANES, half = settings->block / 2;
    uint16_t *TOKT_RESTRICT block = sums->block;
    if (x - from > half) {
        memset(block, 0, count * sizeof *block);
        *texture = 0, from = x - settings->block;
    }
    int anew = from == x - settings->block;
    uint16_t least = UINT16_MAX;
    for (int to = from + 1; to <= x; to++) {
        size_t enter = (size_t)(to - views->first + 2 * half);
        MatchColumn *state = sums->states + enter;
        match_column(views, settings, row, to + half, state, sums->columns + enter * count);
        const uint16_t *TOKT_RESTRICT add = sums->columns + enter * count;
        *texture += state->texture;
        if (anew) {
            for (int e = 0; e < count; e++) block[e] += add[e];
            continue;
        }
        const uint16_t *TOKT_RESTRICT take = add - (size_t)settings->block * count;
        *texture -= state[-settings->block].texture;
        for (int e = 0; e < count; e++) block[e] = (uint16_t)(block[e] + add[e] - take[e]);
    }
    for (int e = 0; e < count; e++) least = block[e] < least ? block[e] : least;
    return least;
}

TOKT_BODY void match_row(const MatchViews *views, const MatchSettings *settings,
                         const MatchSums *sums, int row, int16_t *out) {
    int count = settings->count & -MATCH_LANES;
    int32_t texture = 0;
    int from = views->first - settings->block;
    for (int x = views->first; x < views->last; x++) {
        size_t at = (size_t)row * views->width + x;
        if (!views->wanted[at]) continue;
        uint16_t least = match_block(views, settings, sums, row, from, x, &texture);
        from = x;
        if (texture < settings->texture) continue;
        int place = match_place(sums->block, sums->order, count, least);
        if (settings->uniqueness > 0 &&
            match_rivals(sums->block, count, place, settings->uniqueness))
            continue;
        out[at] = match_between(sums->block, count, place, settings->smallest);
    }
}

/* Write the disparities of what is wanted and can be told; the rest of `out` stays as it is. */
TOKT_BODY void match_views_body(const MatchViews *views, const MatchSettings *settings,
                                uint16_t *scratch, int16_t *out) {
    int wide = views->last - views->first + settings->block - 1;
    int count = settings->count & -MATCH_LANES;
    MatchSums sums = {scratch + 2 * count, scratch + count, scratch,
                      (MatchColumn *)(scratch + (size_t)(wide + 2) * count)};
    for (int e = 0; e < count; e++) scratch[e] = (uint16_t)e;
    for (int x = 0; x < wide; x++) sums.states[x].row = views->top - settings->block;
    for (int row = views->top; row < views->bottom; row++)
        match_row(views, settings, &sums, row, out);
}

TOKT_VARIANTS_TO_AVX2(match_views,
                      (const MatchViews *views, const MatchSettings *settings, uint16_t *scratch,
                       int16_t *out),
                      (views, settings, scratch, out))

#endif
