/* A view's local contrast: the standard deviation around each pixel, and the view made even by it.
 *
 * The bits of OpenCV's `boxFilter` and `sqrBoxFilter`: sums in double precision that are carried
 * from pixel to pixel along a row, then from row to row down a column. A row by itself would wait
 * for each of its additions: several are carried side by side. */
#ifndef TOKT_CONTRAST_H
#define TOKT_CONTRAST_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { CONTRAST_ROWS = 4 /* that are carried side by side */ };
#define CONTRAST_WHOLE 12582912.0f /* 3 * 2^22: what is added to it is rounded to a whole number */

typedef struct {
    const float *view;
    ptrdiff_t height, width; /* both larger than the window */
    ptrdiff_t window;        /* height and width of what is around a pixel, odd, from 7 */
    float gain;              /* grey levels that one deviation becomes, around 128 */
    float least;             /* grey levels that a smaller deviation counts as */
} ContrastView;

/* Rows whose sums are kept: those around a pixel, and those made ahead. */
TOKT_BODY ptrdiff_t contrast_kept(const ContrastView *view) {
    return (view->window / CONTRAST_ROWS + 2) * CONTRAST_ROWS;
}

/* Doubles that `contrast_view` needs as scratch: sums and totals, two values a pixel, and a row. */
static size_t contrast_scratch(const ContrastView *view) {
    return (size_t)((2 * contrast_kept(view) + 3) * view->width + view->window);
}

/* A place beyond the picture's edge is its mirror image's. */
TOKT_BODY ptrdiff_t contrast_mirrored(ptrdiff_t at, ptrdiff_t length) {
    at = at < 0 ? -at : at;
    return at < length ? at : 2 * (length - 1) - at;
}

/* Write a row's first sum over the window and that of squares, and by how much the next differ. */
TOKT_BODY void contrast_changes(const ContrastView *view, const float *TOKT_RESTRICT row,
                                float *TOKT_RESTRICT wide, double *TOKT_RESTRICT sums,
                                double *TOKT_RESTRICT squares) {
    ptrdiff_t width = view->width, window = view->window, half = window / 2;
    memcpy(wide + half, row, (size_t)width * sizeof *row);
    for (ptrdiff_t x = 0; x < half; x++) {
        wide[x] = row[half - x];
        wide[half + width + x] = row[width - 2 - x];
    }
    sums[0] = squares[0] = 0;
    for (ptrdiff_t x = 0; x < window; x++) {
        sums[0] += (double)wide[x];
        squares[0] += (double)wide[x] * (double)wide[x];
    }
    for (ptrdiff_t x = 1; x < width; x++) {
        double enter = wide[x + window - 1], leave = wide[x - 1];
        sums[x] = enter - leave;
        squares[x] = enter * enter - leave * leave;
    }
}

/* Make sums of the changes of rows that are `width` values long, one behind the other. */
TOKT_BODY void contrast_carry(double *TOKT_RESTRICT rows, ptrdiff_t width) {
    double sums[2 * CONTRAST_ROWS] = {0};
    for (ptrdiff_t x = 0; x < width; x++)
        for (int row = 0; row < 2 * CONTRAST_ROWS; row++)
            rows[row * width + x] = sums[row] += rows[row * width + x];
}

/* Write a row whose totals lack the row `enter`, and take `leave` away from them. */
TOKT_BODY void contrast_row(const ContrastView *view, const float *TOKT_RESTRICT row,
                            const double *TOKT_RESTRICT enter, const double *TOKT_RESTRICT leave,
                            double *TOKT_RESTRICT totals, float *TOKT_RESTRICT sigma,
                            uint8_t *TOKT_RESTRICT even) {
    ptrdiff_t width = view->width;
    double share = 1.0 / (double)(view->window * view->window);
    float least = view->least, gain = view->gain;
    for (ptrdiff_t x = 0; x < width; x++) {
        double sum = totals[x] + enter[x], square = totals[width + x] + enter[width + x];
        totals[x] = sum - leave[x];
        totals[width + x] = square - leave[width + x];
        float mean = (float)(sum * share), variance = (float)(square * share) - mean * mean;
        sigma[x] = sqrtf(variance > 0 ? variance : 0);
        float level = (row[x] - mean) * gain / (sigma[x] > least ? sigma[x] : least) + 128;
        int32_t whole = (int32_t)(level + CONTRAST_WHOLE - CONTRAST_WHOLE);
        whole = whole > 0 ? whole : 0;
        even[x] = (uint8_t)(whole < 255 ? whole : 255);
    }
}

/* Write the deviations around all pixels, and the even view. */
TOKT_BODY void contrast_view_body(const ContrastView *view, double *scratch, float *sigma,
                                  uint8_t *even) {
    ptrdiff_t width = view->width, height = view->height, half = view->window / 2;
    ptrdiff_t kept = contrast_kept(view), apart = 2 * width, made = 0;
    double *totals = scratch, *sums = totals + apart;
    float *wide = (float *)(sums + kept * apart);
    memset(totals, 0, (size_t)apart * sizeof *totals);
    for (ptrdiff_t y = -2 * half; y < height; y++) {
        while (made < height && made <= (y > 0 ? y + half : half)) {
            double *rows = sums + made % kept * apart;
            for (ptrdiff_t row = 0; row < CONTRAST_ROWS; row++, made++) {
                const float *in = view->view + (made < height ? made : height - 1) * width;
                contrast_changes(view, in, wide, rows + row * apart, rows + row * apart + width);
            }
            contrast_carry(rows, width);
        }
        const double *enter = sums + contrast_mirrored(y + half, height) % kept * apart;
        const double *leave = sums + contrast_mirrored(y - half, height) % kept * apart;
        for (ptrdiff_t x = 0; y < 0 && x < apart; x++) totals[x] += enter[x];
        if (y >= 0)
            contrast_row(view, view->view + y * width, enter, leave, totals, sigma + y * width,
                         even + y * width);
    }
}

TOKT_VARIANTS_TO_AVX2(contrast_view,
                      (const ContrastView *view, double *scratch, float *sigma, uint8_t *even),
                      (view, scratch, sigma, even))

#endif
