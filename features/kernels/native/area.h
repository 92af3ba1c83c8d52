/* Gray pictures of a BGR or gray frame, resized by area, in one pass over the frame.
 *
 * A source pixel is `target` units long and a picture's pixel `source` units, so every overlap is
 * a whole number, and so is every sum: any order of adding gives the same bits. Whole rows are
 * added first, which a processor does many pixels at a time. The caller sees to it that a sum of
 * the largest frame stays below 2^32.
 *
 * Of the same sums two pictures are made. The 16-bit one is in 1/256 grey level, rounded once. The
 * plain one is OpenCV's `resize(..., INTER_AREA)` followed by `cvtColor(..., COLOR_BGR2GRAY)`: each
 * step rounded to whole grey levels. OpenCV sums in single precision, so only a value that lies
 * very near the middle between two grey levels can come out differently. How near depends on how
 * many terms a sum has (`near_tie`, from the caller); those few are summed again as OpenCV does. */
#ifndef TOKT_AREA_H
#define TOKT_AREA_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum {
    AREA_LANES = 4, /* values a pixel of a row that was summed along: B, G, R and one unused */
    AREA_CACHE_LINE = 64, /* bytes */
    AREA_CHUNK = 64 /* values that are looked through together for near ties */
};

typedef struct {
    const uint8_t *pixels;
    ptrdiff_t stride; /* bytes from row to row */
    int width, channels;
} AreaFrame;

/* Which input rows (or columns) make one output row: a part of the first, `inner` whole ones, and a
 * part of the last, which is 0 where there is no last one. */
typedef struct {
    const int32_t *source, *inner, *first, *last; /* [outputs] */
    int32_t whole;                                /* weight of a whole one */
} AreaTable;

/* The same with the weights of OpenCV, in single precision: those of an output begin at `first`. */
typedef struct {
    const int32_t *first, *source;
    const float *weight;
} TieTable;

/* What pictures are made with. */
typedef struct {
    AreaTable rows, columns;
    TieTable tie_rows, tie_columns;
    int width;       /* of the pictures */
    double unit;     /* one by the units of a pixel */
    float near_tie;  /* grey levels */
} AreaTables;

/* Bytes that a row of a picture needs as scratch; the frame's row is read one value beyond. */
static size_t area_scratch(const AreaFrame *frame, int width) {
    size_t in = (size_t)frame->width * frame->channels + AREA_LANES, out = (size_t)width;
    return out * sizeof(double) + (in + (2 * AREA_LANES + 1) * out) * sizeof(int32_t);
}

/* Add up the frame's rows that make row y of the picture. Mostly those are a part of one, two or
 * three whole ones, which are added as whole numbers, and a part of the last: one pass. */
TOKT_BODY void area_add_rows(const AreaFrame *frame, const AreaTable *rows, int y,
                             int32_t *TOKT_RESTRICT sums) {
    int n = frame->width * frame->channels, inner = rows->inner[y];
    int32_t part = rows->first[y], whole = rows->whole, last = rows->last[y];
    const uint8_t *TOKT_RESTRICT a = frame->pixels + rows->source[y] * frame->stride;
    const uint8_t *TOKT_RESTRICT end = last ? a + (inner + 1) * frame->stride : a;
    const uint8_t *TOKT_RESTRICT b = a + frame->stride, *TOKT_RESTRICT c = b + frame->stride;
    const uint8_t *TOKT_RESTRICT d = c + frame->stride;
    if (inner == 2) {
        for (int x = 0; x < n; x++) sums[x] = part * a[x] + whole * (b[x] + c[x]) + last * end[x];
    } else if (inner == 3) {
        for (int x = 0; x < n; x++)
            sums[x] = part * a[x] + whole * (b[x] + c[x] + d[x]) + last * end[x];
    } else {
        for (int x = 0; x < n; x++) sums[x] = part * a[x] + last * end[x];
        for (int row = 1; row <= inner; row++) {
            const uint8_t *TOKT_RESTRICT in = a + row * frame->stride;
            for (int x = 0; x < n; x++) sums[x] += whole * in[x];
        }
    }
}

/* Add up the columns of a gray frame's `sums` that make each pixel of the picture's row. */
TOKT_BODY void area_add_gray(const AreaTables *tables, const int32_t *sums,
                             uint32_t *TOKT_RESTRICT out) {
    const AreaTable *columns = &tables->columns;
    for (ptrdiff_t x = 0; x < tables->width; x++) {
        const int32_t *in = sums + columns->source[x];
        int inner = columns->inner[x];
        uint32_t whole = 0;
        for (int i = 1; i <= inner; i++) whole += (uint32_t)in[i];
        out[x] = (uint32_t)columns->first[x] * (uint32_t)in[0] + (uint32_t)columns->whole * whole +
                 (uint32_t)columns->last[x] * (uint32_t)in[inner + 1];
    }
}

/* Blue, green and red side by side; the fourth value is the next pixel's. */
#if defined(__GNUC__)
typedef uint32_t AreaPixel __attribute__((vector_size(16), aligned(4), may_alias));
#define AREA_ADD(sum, factor, at) sum += (factor) * *(const AreaPixel *)(at)
#else
typedef struct {
    uint32_t of[AREA_LANES];
} AreaPixel;
#define AREA_ADD(sum, factor, at) \
    for (int lane = 0; lane < AREA_LANES; lane++) (sum).of[lane] += (factor) * (uint32_t)(at)[lane]
#endif

/* The same of a BGR frame. The rows of the picture's row `next` are asked for meanwhile, a cache
 * line a pixel: memory delivers while columns are added up. */
TOKT_BODY void area_add_colours(const AreaFrame *frame, const AreaTables *tables, int next,
                                const int32_t *sums, uint32_t *TOKT_RESTRICT out) {
    const AreaTable *columns = &tables->columns;
    const int32_t *sources = columns->source, *inners = columns->inner;
    const int32_t *firsts = columns->first, *lasts = columns->last;
    uint32_t whole = (uint32_t)columns->whole;
    const uint8_t *ahead = frame->pixels + tables->rows.source[next] * frame->stride;
    const uint8_t *until = ahead + (tables->rows.inner[next] + 2) * frame->stride;
    for (ptrdiff_t x = 0, width = tables->width; x < width; x++, ahead += AREA_CACHE_LINE) {
        if (ahead < until) TOKT_PREFETCH(ahead);
        const int32_t *in = sums + 3 * (ptrdiff_t)sources[x], *end = in + 3 * inners[x];
        AreaPixel sum = {0};
        if (inners[x] == 2) { /* as of most frames, as is 3 */
            AREA_ADD(sum, 1, in + 3);
            AREA_ADD(sum, 1, in + 6);
        } else if (inners[x] == 3) {
            AREA_ADD(sum, 1, in + 3);
            AREA_ADD(sum, 1, in + 6);
            AREA_ADD(sum, 1, in + 9);
        } else {
            for (const int32_t *at = in + 3; at <= end; at += 3) AREA_ADD(sum, 1, at);
        }
        AreaPixel all = {0};
        AREA_ADD(all, whole, (const int32_t *)&sum);
        AREA_ADD(all, (uint32_t)firsts[x], in);
        AREA_ADD(all, (uint32_t)lasts[x], end + 3);
        memcpy(out + AREA_LANES * x, &all, sizeof all);
    }
}

/* Write a row in 1/256 grey level. ITU-R BT.601 in 2^14 parts; the sum is exact below 2^53. */
TOKT_BODY void area_gray16(const uint32_t *TOKT_RESTRICT along, int channels, ptrdiff_t width,
                           double unit, double *TOKT_RESTRICT gray,
                           uint16_t *TOKT_RESTRICT out) {
    double step = 256.0 / 16384.0 * unit;
    if (channels == 1)
        for (ptrdiff_t x = 0; x < width; x++) gray[x] = 16384.0 * along[x];
    else if (255.0 / unit < INT32_MAX) /* signed numbers are converted at once */
        for (ptrdiff_t x = 0; x < width; x++) {
            const int32_t *pixel = (const int32_t *)along + AREA_LANES * x;
            gray[x] = 1868.0 * pixel[0] + 9617.0 * pixel[1] + 4899.0 * pixel[2];
        }
    else
        for (ptrdiff_t x = 0; x < width; x++) {
            const uint32_t *pixel = along + AREA_LANES * x;
            gray[x] = 1868.0 * pixel[0] + 9617.0 * pixel[1] + 4899.0 * pixel[2];
        }
    for (ptrdiff_t x = 0; x < width; x++) out[x] = (uint16_t)(int32_t)(gray[x] * step + 0.5);
}

/* One value as OpenCV sums it, rounded. */
static int area_exact(const AreaFrame *frame, const AreaTables *tables, int y, int x, int channel) {
    const TieTable *rows = &tables->tie_rows, *columns = &tables->tie_columns;
    const uint8_t *in = frame->pixels + rows->source[y] * frame->stride +
                        (ptrdiff_t)columns->source[x] * frame->channels + channel;
    const float *across = columns->weight + columns->first[x];
    int count = columns->first[x + 1] - columns->first[x];
    float sum = 0;
    for (int row = rows->first[y]; row < rows->first[y + 1]; row++, in += frame->stride) {
        float along = 0;
        for (int i = 0; i < count; i++) along += (float)in[i * frame->channels] * across[i];
        sum += rows->weight[row] * along;
    }
    return (int)lrintf(sum);
}

/* A sum in grey levels, in single precision; the lowest bit is left out, as signed numbers are
 * converted at once. */
TOKT_BODY float area_level(uint32_t sum, float two_units) { return (int32_t)(sum >> 1) * two_units; }

TOKT_BODY int area_is_tie(float value, int32_t level, float near_tie) {
    return fabsf(value - (float)level) > 0.5f - near_tie;
}

/* Round sums to whole grey levels; returns how many lie too near the middle of two to tell. */
TOKT_BODY int area_round(const uint32_t *TOKT_RESTRICT along, ptrdiff_t n, float two_units,
                         float near_tie, int32_t *TOKT_RESTRICT levels) {
    int near = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        float value = area_level(along[i], two_units);
        levels[i] = (int32_t)(value + 0.5f);
        near += area_is_tie(value, levels[i], near_tie);
    }
    return near;
}

/* Decide the values first..last that `area_round` could not. */
static void area_settle(const AreaFrame *frame, const AreaTables *tables, int y, int first,
                        int last, float two_units, const uint32_t *along, int32_t *levels) {
    int lanes = frame->channels == 1 ? 1 : AREA_LANES;
    for (int i = first; i < last; i++)
        if (i % lanes < frame->channels &&
            area_is_tie(area_level(along[i], two_units), levels[i], tables->near_tie))
            levels[i] = area_exact(frame, tables, y, i / lanes, i % lanes);
}

/* Write row y in whole grey levels. */
TOKT_BODY void area_gray8(const AreaFrame *frame, const AreaTables *tables, int y,
                          const uint32_t *along, int32_t *TOKT_RESTRICT levels,
                          int32_t *TOKT_RESTRICT gray, uint8_t *TOKT_RESTRICT out) {
    int lanes = frame->channels == 1 ? 1 : AREA_LANES, all = lanes * tables->width;
    float two_units = (float)(2 * tables->unit), near_tie = tables->near_tie;
    for (int i = 0; i < all; i += AREA_CHUNK) {
        int n = all - i < AREA_CHUNK ? all - i : AREA_CHUNK;
        if (area_round(along + i, n, two_units, near_tie, levels + i))
            area_settle(frame, tables, y, i, i + n, two_units, along, levels);
    }
    if (lanes == 1) {
        for (ptrdiff_t x = 0; x < tables->width; x++) out[x] = (uint8_t)levels[x];
        return;
    }
    /* ITU-R BT.601 in OpenCV's fixed point. */
    for (ptrdiff_t x = 0; x < tables->width; x++) {
        const int32_t *pixel = levels + AREA_LANES * x;
        gray[x] = (pixel[0] * 3735 + pixel[1] * 19235 + pixel[2] * 9798 + (1 << 14)) >> 15;
    }
    for (ptrdiff_t x = 0; x < tables->width; x++) out[x] = (uint8_t)gray[x];
}

/* Rows first..last of the 16-bit picture and of the plain one, either of which may be NULL. */
TOKT_BODY void area_rows_body(const AreaFrame *frame, const AreaTables *tables, int first,
                              int last, char *scratch, uint16_t *gray16, uint8_t *gray8) {
    ptrdiff_t width = tables->width, n = (ptrdiff_t)frame->width * frame->channels + AREA_LANES;
    double *gray = (double *)scratch;
    int32_t *sums = (int32_t *)(gray + width), *levels = sums + n;
    int32_t *plain = levels + AREA_LANES * width;
    uint32_t *along = (uint32_t *)(plain + width);
    /* What follows a row is read as the fourth value of its last pixel. */
    for (int lane = 1; lane <= AREA_LANES; lane++) sums[n - lane] = 0;
    for (int y = first; y < last; y++) {
        area_add_rows(frame, &tables->rows, y, sums);
        if (frame->channels == 1)
            area_add_gray(tables, sums, along);
        else
            area_add_colours(frame, tables, y + 1 < last ? y + 1 : y, sums, along);
        if (gray16) area_gray16(along, frame->channels, width, tables->unit, gray, gray16 + y * width);
        if (gray8) area_gray8(frame, tables, y, along, levels, plain, gray8 + y * width);
    }
}

TOKT_VARIANTS(area_rows,
              (const AreaFrame *frame, const AreaTables *tables, int first, int last,
               char *scratch, uint16_t *gray16, uint8_t *gray8),
              (frame, tables, first, last, scratch, gray16, gray8))

#endif
