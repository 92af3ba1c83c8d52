// What this browser keeps: what a person set, who works in this tab, and all else that is stored
// under a name. Storage may be full, switched off or cleared at any moment.

import { signal } from "./dom.js";

// Reading the property itself throws where a browser blocks storage.
function area(name) {
  try {
    return window[name];
  } catch {
    return null;
  }
}

const areas = { local: area("localStorage"), session: area("sessionStorage") };

/** What is stored under a name, parsed; null where there is nothing or it cannot be read. */
export function read(name, store = areas.local) {
  try {
    return JSON.parse(store.getItem(name));
  } catch {
    return null;
  }
}

/** Store a value; whether it is there then. */
export function write(name, value, store = areas.local) {
  const text = JSON.stringify(value);
  try {
    store.setItem(name, text);
    return store.getItem(name) === text;
  } catch {
    return false;
  }
}

/** Forget a name. */
export function remove(name) {
  try {
    areas.local.removeItem(name);
  } catch {
    // Storage is switched off: there is nothing to forget.
  }
}

/** The stored names that start with a text, sorted. */
export function names(prefix) {
  try {
    return Object.keys(areas.local).filter((name) => name.startsWith(prefix)).sort();
  } catch {
    return [];
  }
}

const SETTINGS = "tokt.settings";
const IDENTITY = "tokt.identity";

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
};

let settings = { ...DEFAULTS, ...read(SETTINGS) };

/** Be told of changed settings: `onSetting((name, value) => ...)` returns what stops it. */
const [onSetting, settingChanged] = signal();
export { onSetting };

/** The value of a setting. */
export function setting(name) {
  return settings[name];
}

/** Change a setting; kept in this browser where it lets us. */
export function setSetting(name, value) {
  if (settings[name] === value) return;
  settings = { ...settings, [name]: value };
  write(SETTINGS, settings);
  settingChanged(name, value);
}

/** Make a number among the settings larger or smaller, from 0 to `most`. */
export function changeSetting(name, by, most) {
  const value = Math.round((settings[name] + by) * 100) / 100;
  setSetting(name, Math.min(most, Math.max(0, value)));
}

// A tab keeps its person over reloads; a new tab starts as the last one on this computer did.
let identity = read(IDENTITY, areas.session) ?? read(IDENTITY) ?? {};

/** The annotator of this tab; "" until a person said so. */
export function who() {
  // With a preset it is of an earlier tokt, which asked nobody.
  return identity.preset ? "" : (identity.who ?? "");
}

/** Who worked here last, to propose: {who, blind}; an earlier tokt kept `blind` in the browser. */
export function lastPerson() {
  return identity;
}

/** Choose who works here. */
export function setWho(name) {
  identity = { who: name };
  write(IDENTITY, identity, areas.session);
  write(IDENTITY, identity);
}
