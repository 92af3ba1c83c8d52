/* Sums along lines through every pixel, in eight directions, summed up over patches.
 *
 * A line of 2n samples is one of n and another that begins where it ends, so a few additions of
 * whole rows give all lengths that are powers of 2, in any direction. Sums of 64 levels fit 16
 * bits, many of which a processor adds at a time. Strips of a few rows of patches are worked on
 * one after the other: what a strip takes stays in the cache, though what lies around it is
 * summed again. */
#ifndef TOKT_LINES_H
#define TOKT_LINES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"
#include "structure.h"

enum {
    LINE_DIRECTIONS = 8,
    LINE_SUMS = LINE_DIRECTIONS + 1,
    LINE_STRIP = 160 /* rows of pixels in a strip, unless a patch is higher */
};

#if defined(__GNUC__)
/* A row is added to what lies behind it: what is read was not written before. */
#define TOKT_READS_AHEAD _Pragma("GCC ivdep")
#else
#define TOKT_READS_AHEAD
#endif

static const int line_steps[LINE_DIRECTIONS][2] = {{0, 2}, {1, 2},  {1, 1},  {2, 1},
                                                   {2, 0}, {2, -1}, {1, -1}, {1, -2}};

typedef struct {
    int middle;         /* the level that counts as nothing */
    int count;          /* of: */
    const int32_t *samples; /* increasing powers of 2 */
} LineKinds;

/* What one strip is worked on with. */
typedef struct {
    int reach, stride, rows; /* of the strip with what lies around it */
    int top, height;         /* of the strip in the picture */
    int16_t *signed_levels;  /* [rows][stride], 0 beyond the picture */
    int16_t *line;           /* [rows][stride] sums from a sample on, in one direction */
    int16_t *largest;        /* [count][height][width] of all directions */
    uint32_t *squares;       /* [width] of some rows of pixels */
    int32_t *plain;          /* [width] */
} LineStrip;

static int line_strip_patches(const PatchedPicture *picture) {
    return picture->patch_height < LINE_STRIP ? LINE_STRIP / picture->patch_height : 1;
}

/* Int16 values that `lines_rows` needs as scratch. */
static size_t lines_scratch(const PatchedPicture *picture, const LineKinds *kinds) {
    size_t height = (size_t)line_strip_patches(picture) * picture->patch_height;
    size_t reach = kinds->samples[kinds->count - 1], width = picture->width;
    return 4 * width + 2 * (height + 2 * reach) * (width + 2 * reach) + kinds->count * height * width;
}

static void lines_lay_out(LineStrip *strip, const PatchedPicture *picture, const LineKinds *kinds,
                          int first, int last, int16_t *memory) {
    strip->reach = kinds->samples[kinds->count - 1];
    strip->stride = picture->width + 2 * strip->reach;
    strip->top = first * picture->patch_height;
    strip->height = (last - first) * picture->patch_height;
    strip->rows = strip->height + 2 * strip->reach;
    size_t size = (size_t)strip->rows * strip->stride;
    strip->squares = (uint32_t *)memory;
    strip->plain = (int32_t *)(strip->squares + picture->width);
    strip->signed_levels = (int16_t *)(strip->plain + picture->width);
    strip->line = strip->signed_levels + size;
    strip->largest = strip->line + size;
}

TOKT_BODY void lines_load(const LineStrip *strip, const PatchedPicture *picture, int middle) {
    for (int row = 0; row < strip->rows; row++) {
        int16_t *TOKT_RESTRICT out = strip->signed_levels + (size_t)row * strip->stride;
        int y = strip->top - strip->reach + row;
        if (y < 0 || y >= picture->height) {
            memset(out, 0, strip->stride * sizeof(int16_t));
            continue;
        }
        const uint8_t *TOKT_RESTRICT in = picture->pixels + (ptrdiff_t)y * picture->width;
        memset(out, 0, strip->reach * sizeof(int16_t));
        out += strip->reach;
        for (int x = 0; x < picture->width; x++) out[x] = (int16_t)(in[x] - middle);
        memset(out + picture->width, 0, strip->reach * sizeof(int16_t));
    }
}

/* Make lines of 2n samples of lines of n: a step of n samples on, another one begins. Done are the
 * rows in which the longest lines, of `most` samples, or any part of them begin; sums whose second
 * line begins beyond the strip are never looked at. */
TOKT_BODY void lines_double(const LineStrip *strip, int n, int most, const int step[2]) {
    ptrdiff_t ahead = n * ((ptrdiff_t)step[0] * strip->stride + step[1]);
    ptrdiff_t from = strip->reach - most / 2 * step[0];
    ptrdiff_t to = (from + strip->height + (most - 2 * n) * step[0]) * strip->stride;
    ptrdiff_t end = (ptrdiff_t)strip->rows * strip->stride - ahead;
    int16_t *line = strip->line;
    if (to < end) end = to;
    if (n == 1) {
        const int16_t *TOKT_RESTRICT in = strip->signed_levels;
        int16_t *TOKT_RESTRICT out = line;
        for (ptrdiff_t i = from * strip->stride; i < end; i++)
            out[i] = (int16_t)(in[i] + in[i + ahead]);
        return;
    }
    TOKT_READS_AHEAD
    for (ptrdiff_t i = from * strip->stride; i < end; i++)
        line[i] = (int16_t)(line[i] + line[i + ahead]);
}

/* Add up columns of some rows of pixels by patch. */
TOKT_BODY void lines_add_up(const LineStrip *strip, const PatchedPicture *picture, int direction,
                            ptrdiff_t step, int64_t *sums) {
    for (int col = 0; col < picture->cols; col++) {
        const uint32_t *squares = strip->squares + (size_t)col * picture->patch_width;
        const int32_t *plain = strip->plain + (size_t)col * picture->patch_width;
        int64_t squared = 0, total = 0;
        for (int x = 0; x < picture->patch_width; x++) {
            squared += squares[x];
            total += plain[x];
        }
        sums[col * step] += total;
        sums[col * step + 1 + direction] += squared;
    }
}

/* Take a row of lines into what is added up by column, and into the largest. */
TOKT_BODY void lines_take_row(const LineStrip *strip, const int16_t *TOKT_RESTRICT line,
                              int16_t *TOKT_RESTRICT largest, int width) {
    uint32_t *TOKT_RESTRICT squares = strip->squares;
    int32_t *TOKT_RESTRICT plain = strip->plain;
    for (int x = 0; x < width; x++) {
        int16_t sum = line[x], before = largest[x];
        squares[x] += (uint32_t)((int32_t)sum * sum);
        plain[x] -= sum;
        largest[x] = sum > before ? sum : before;
    }
}

/* The same of two rows at once, whose sums of at most 64 levels fit 16 bits together. */
TOKT_BODY void lines_take_two(const LineStrip *strip, const int16_t *TOKT_RESTRICT upper,
                              int16_t *TOKT_RESTRICT largest, int width) {
    uint32_t *TOKT_RESTRICT squares = strip->squares;
    int32_t *TOKT_RESTRICT plain = strip->plain;
    const int16_t *TOKT_RESTRICT lower = upper + strip->stride;
    int16_t *TOKT_RESTRICT below = largest + width;
    for (int x = 0; x < width; x++) {
        int16_t one = upper[x], other = lower[x];
        squares[x] += (uint32_t)((int32_t)one * one) + (uint32_t)((int32_t)other * other);
        plain[x] -= (int16_t)(one + other);
        largest[x] = one > largest[x] ? one : largest[x];
        below[x] = other > below[x] ? other : below[x];
    }
}

/* Take one direction's lines of n samples into the largest, and the sums of all patches. */
TOKT_BODY void lines_take(const LineStrip *strip, const PatchedPicture *picture,
                          const LineKinds *kinds, int kind, int direction, int64_t *sums) {
    int n = kinds->samples[kind], width = picture->width, patch_height = picture->patch_height;
    ptrdiff_t begin = (ptrdiff_t)(strip->reach - n / 2 * line_steps[direction][0]) * strip->stride +
                      strip->reach - n / 2 * line_steps[direction][1];
    ptrdiff_t step = (ptrdiff_t)kinds->count * LINE_SUMS;
    /* Rows whose squares fit 32 bits together. */
    uint32_t most = UINT32_MAX / ((uint32_t)(255 * n) * (uint32_t)(255 * n));
    for (int y = 0; y < strip->height;) {
        int stop = (y / patch_height + 1) * patch_height;
        if ((uint32_t)(stop - y) > most) stop = y + (int)most;
        memset(strip->squares, 0, width * sizeof(uint32_t));
        memset(strip->plain, 0, width * sizeof(int32_t));
        int64_t *out = sums + ((ptrdiff_t)(y / patch_height) * picture->cols * kinds->count + kind) *
                                  LINE_SUMS;
        while (y < stop) {
            const int16_t *line = strip->line + begin + (ptrdiff_t)y * strip->stride;
            int16_t *largest = strip->largest + ((size_t)kind * strip->height + y) * width;
            int rows = y + 1 < stop ? 2 : 1;
            for (int row = 0; direction == 0 && row < rows; row++)
                memcpy(largest + (size_t)row * width, line + row * strip->stride,
                       width * sizeof(int16_t));
            if (rows == 2)
                lines_take_two(strip, line, largest, width);
            else
                lines_take_row(strip, line, largest, width);
            y += rows;
        }
        lines_add_up(strip, picture, direction, step, out);
    }
}

/* Add 8 times the largest of all directions to each patch's first sum. */
TOKT_BODY void lines_finish(const LineStrip *strip, const PatchedPicture *picture,
                            const LineKinds *kinds, int64_t *sums) {
    for (int kind = 0; kind < kinds->count; kind++)
        for (int y = 0; y < strip->height; y++) {
            const int16_t *largest = strip->largest + ((size_t)kind * strip->height + y) * picture->width;
            int row = y / picture->patch_height;
            for (int col = 0; col < picture->cols; col++, largest += picture->patch_width) {
                int32_t sum = 0;
                for (int x = 0; x < picture->patch_width; x++) sum += largest[x];
                sums[(((ptrdiff_t)row * picture->cols + col) * kinds->count + kind) * LINE_SUMS] +=
                    LINE_DIRECTIONS * (int64_t)sum;
            }
        }
}

/* Write the sums of patch rows first..last. */
TOKT_BODY void lines_rows_body(const PatchedPicture *picture, const LineKinds *kinds, int first,
                               int last, int16_t *scratch, int64_t *sums) {
    int at_once = line_strip_patches(picture);
    for (int row = first; row < last; row += at_once) {
        LineStrip strip;
        int end = last - row < at_once ? last : row + at_once;
        ptrdiff_t patch_row = (ptrdiff_t)picture->cols * kinds->count * LINE_SUMS;
        int64_t *out = sums + row * patch_row;
        memset(out, 0, (size_t)(end - row) * patch_row * sizeof(int64_t));
        lines_lay_out(&strip, picture, kinds, row, end, scratch);
        lines_load(&strip, picture, kinds->middle);
        for (int direction = 0; direction < LINE_DIRECTIONS; direction++) {
            for (int n = 1, kind = 0; kind < kinds->count; n *= 2) {
                lines_double(&strip, n, kinds->samples[kinds->count - 1], line_steps[direction]);
                if (kinds->samples[kind] == 2 * n)
                    lines_take(&strip, picture, kinds, kind++, direction, out);
            }
        }
        lines_finish(&strip, picture, kinds, out);
    }
}

TOKT_VARIANTS(lines_rows,
              (const PatchedPicture *picture, const LineKinds *kinds, int first, int last,
               int16_t *scratch, int64_t *sums),
              (picture, kinds, first, last, scratch, sums))

#endif
