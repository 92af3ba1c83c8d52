// Work put together until the browser draws next.

/**
 * A function that runs `work` once before the next drawing, however often it is called.
 * @param {Function} work
 * @returns {Function}
 */
export function soon(work) {
  let waiting = false;
  return () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      work();
    });
  };
}
