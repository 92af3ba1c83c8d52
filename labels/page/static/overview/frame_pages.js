// Which frames one page of the overview shows.

const MIN_WIDTH = 60; // CSS pixels
// So much of a row may be missing: pictures a little smaller are better than an empty strip.
const SQUEEZED = 0.2;

/**
 * How many thumbnails fit.
 * @param {{width: number, height: number}} room In CSS pixels.
 * @param {{columns: number, aspect: number, gap: number, caption: number}} plan
 *   `aspect`: height of a picture over its width; `caption`: height of what stands under it.
 * @returns {{count: number, width: number, height: number}} Thumbnails, and each one's picture.
 */
export function pageSize(room, { columns, aspect, gap, caption }) {
  const widest = Math.max(MIN_WIDTH, Math.floor((room.width - (columns - 1) * gap) / columns));
  const fitting = (room.height + gap) / (Math.round(widest * aspect) + caption + gap);
  const rows = Math.max(1, Math.floor(fitting + SQUEEZED));
  const share = (room.height + gap) / rows - gap - caption; // of the height, for each picture
  const height = Math.min(Math.round(widest * aspect), Math.max(Math.floor(share), 40));
  return { count: rows * columns, width: Math.min(widest, Math.round(height / aspect)), height };
}

/** The first `count` frames from index `from` on that the filter keeps. */
export function framesFrom(list, from, count, keeps) {
  const found = [];
  for (let at = from; at < list.length && found.length < count; at += 1) {
    if (keeps(list[at])) found.push(list[at]);
  }
  return found;
}

/** The last `count` frames before index `until` that the filter keeps, ascending. */
export function framesBefore(list, until, count, keeps) {
  const found = [];
  for (let at = until - 1; at >= 0 && found.length < count; at -= 1) {
    if (keeps(list[at])) found.push(list[at]);
  }
  return found.reverse();
}
