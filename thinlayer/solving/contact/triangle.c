/* The upper triangle of a part of a symmetric sparse matrix whose nodes are numbered anew. */
#include <stdint.h>

/* Copies the triangle to new arrays; returns the number of its entries, or -1 if the matrix is not as described here or has
 * more entries than there is room for.
 *
 * The entries of the matrix form blocks of d x d, one row of blocks for each node. The part has n nodes; nodes[r] is the
 * node whose new number is r, and place[nodes[r]] = r; other nodes have the place -1. In each row columns ascend. Of the rows
 * and columns of held unknowns only the diagonal stays. */
int upper_triangle(int n, int d, int room, const int32_t *indptr, const int32_t *indices, const double *values,
                   const uint8_t *held, const int32_t *place, const int32_t *nodes, int32_t *rows, int32_t *columns,
                   double *entries)
{
    int32_t filled = 0, block[4096], number[4096]; /* of a node's row: place of a block in it, its new column */
    rows[0] = 0;
    for (int r = 0; r < n; r++) {
        /* rows that follow each other here are far apart in memory: fetched some steps ahead, they take half the time */
        if (r + 16 < n) __builtin_prefetch(&indptr[nodes[r + 16] * d]);
        if (r + 8 < n) {
            const int32_t at = indptr[nodes[r + 8] * d];
            const int ahead = d * (indptr[nodes[r + 8] * d + 1] - at);
            for (int k = 0; k < ahead; k += 8) __builtin_prefetch(&values[at + k]);
            for (int k = 0; k < ahead / d; k += 16) __builtin_prefetch(&indices[at + k]);
        }
        const int32_t first = indptr[nodes[r] * d], length = indptr[nodes[r] * d + 1] - first;
        int count = 0;
        if (length % d || length / d > 4096) return -1;
        for (int k = 1; k < d; k++)
            if (indptr[nodes[r] * d + k + 1] - indptr[nodes[r] * d + k] != length) return -1;
        for (int b = 0; b < length / d; b++) {
            const int32_t column = indices[first + b * d];
            if (column % d || indices[first + b * d + d - 1] != column + d - 1) return -1;
            const int32_t to = place[column / d];
            int at = count;
            if (to < r) continue;
            for (; at > 0 && number[at - 1] > to; at--) number[at] = number[at - 1], block[at] = block[at - 1];
            number[at] = to, block[at] = b, count++;
        }
        if (!count || number[0] != r || filled + count * d * d > room + d * (d - 1) / 2) return -1;
        for (int k = 0; k < d; k++) {
            const int row = nodes[r] * d + k;
            for (int c = 0; c < count; c++)
                for (int l = c ? 0 : k; l < d; l++) {
                    const int column = nodes[number[c]] * d + l, cut = column != row && (held[row] || held[column]);
                    columns[filled] = number[c] * d + l;
                    entries[filled++] = cut ? 0 : values[first + k * length + block[c] * d + l];
                }
            rows[r * d + k + 1] = filled;
        }
    }
    return filled;
}
