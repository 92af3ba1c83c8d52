// The browser's storage, where it may be full, switched off or cleared at any moment.

/**
 * What is stored under a name, parsed; null where there is nothing or it cannot be read.
 * @param {string} name
 * @param {Storage} [store]
 */
export function read(name, store = areas.local) {
  try {
    return JSON.parse(store.getItem(name));
  } catch {
    return null;
  }
}

/**
 * Store a value, and look whether it is there.
 * @param {string} name
 * @param {*} value
 * @param {Storage} [store]
 * @returns {boolean} Whether it is stored.
 */
export function write(name, value, store = areas.local) {
  const text = JSON.stringify(value);
  try {
    store.setItem(name, text);
    return store.getItem(name) === text;
  } catch {
    return false;
  }
}

/**
 * Forget a name.
 * @param {string} name
 * @param {Storage} [store]
 */
export function remove(name, store = areas.local) {
  try {
    store.removeItem(name);
  } catch {
    // Storage is switched off: there is nothing to forget.
  }
}

/**
 * The stored names that start with a text, sorted.
 * @param {string} prefix
 * @returns {string[]}
 */
export function names(prefix) {
  try {
    return Object.keys(areas.local).filter((name) => name.startsWith(prefix)).sort();
  } catch {
    return [];
  }
}

// Reading the property itself throws where a browser blocks storage.
function area(name) {
  try {
    return window[name];
  } catch {
    return null;
  }
}

export const areas = { local: area("localStorage"), session: area("sessionStorage") };
