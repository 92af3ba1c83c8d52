// What this browser keeps: what a person set, who works in this tab, and all else that is stored
// under a name. Storage may be full, switched off or cleared at any moment.

import { signal } from "./dom.js";
/** @import { SettingName, Settings, Signal } from "./types.js" */

/** The storage may throw, where a browser blocks it even when it is only named. @template T, U */
function tried(/** @type {() => T} */ work, /** @type {U} */ otherwise) {
  try {
    return work();
  } catch {
    return otherwise;
  }
}

const local = tried(() => window.localStorage, null);
const session = tried(() => window.sessionStorage, null);

/** What is stored under a name, parsed; null where there is nothing or it cannot be read. */
export function read(/** @type {string} */ name, /** @type {?Storage} */ store = local) {
  return tried(() => JSON.parse(store?.getItem(name) ?? "null"), null);
}

/** Store a value; whether it is there then.
 * @param {string} name @param {unknown} value @param {?Storage} [store]
 */
export function write(name, value, store = local) {
  const text = JSON.stringify(value);
  const put = () => {
    store?.setItem(name, text);
    return store?.getItem(name) === text;
  };
  return tried(put, false);
}

export function remove(/** @type {string} */ name) {
  tried(() => local?.removeItem(name), null);
}

/** The stored names that start with a text, sorted. @returns {string[]} */
export function names(/** @type {string} */ prefix) {
  return tried(() => Object.keys(local ?? {}).filter((name) => name.startsWith(prefix)).sort(), []);
}

const SETTINGS = "tokt.settings";
const IDENTITY = "tokt.identity";

/** @type {Settings} */
const DEFAULTS = {
  enhance: 60,
  tint: 25,
  grid: true,
  outlines: true,
  suggestions: true,
  drawer: false,
  confidence: 0.5,
  follow: 2,
  filter: "all",
  rate: 5,
  beside: false,
  selected: "",
  blindOf: "",
  overviewColumns: 0,
  tileWidth: 84,
  tileMargin: 0.25,
};

/** @type {Settings} */
let settings = { ...DEFAULTS, ...read(SETTINGS) };

/** @type {Signal<[name: SettingName]>} Be told of changed settings. */
export const [onSetting, settingChanged] = signal();

/** The value of a setting. @template {SettingName} N */
export function setting(/** @type {N} */ name) {
  return settings[name];
}

/** Change a setting; kept in this browser where it lets us. @template {SettingName} N */
export function setSetting(/** @type {N} */ name, /** @type {Settings[N]} */ value) {
  if (settings[name] === value) return;
  settings = { ...settings, [name]: value };
  write(SETTINGS, settings);
  settingChanged(name);
}

/** Make a number among the settings larger or smaller, from 0 to `most`.
 * @param {"enhance" | "confidence"} name @param {number} by @param {number} most
 */
export function changeSetting(name, by, most) {
  const value = Math.round((settings[name] + by) * 100) / 100;
  setSetting(name, Math.min(most, Math.max(0, value)));
}

// A tab keeps its person over reloads; a new tab starts as the last one on this computer did.
/** @type {{who?: string, blind?: boolean, preset?: boolean}} */
let identity = read(IDENTITY, session) ?? read(IDENTITY) ?? {};

/** The annotator of this tab; "" until a person said so. */
export function who() {
  // With a preset it is of an earlier tokt, which asked nobody.
  return identity.preset ? "" : (identity.who ?? "");
}

/** Who worked here last, to propose: {who, blind}; an earlier tokt kept `blind` in the browser. */
export function lastPerson() {
  return identity;
}

export function setWho(/** @type {string} */ name) {
  identity = { who: name };
  write(IDENTITY, identity, session);
  write(IDENTITY, identity);
}
