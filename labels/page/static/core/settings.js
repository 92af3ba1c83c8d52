// What a person set in this browser, and who works in this tab.

import { areas, read, write } from "./storage.js";

const SETTINGS = "tokt.settings";
const IDENTITY = "tokt.identity";

const DEFAULTS = {
  enhance: 60,
  grid: true,
  outlines: true,
  suggestions: true,
  confidence: 0.5,
  follow: 2,
  obstacleAs: "",
  palette: "taxonomy",
  filter: "all",
  selected: "",
};

let settings = { ...DEFAULTS, ...read(SETTINGS) };
const listeners = new Set();

/**
 * The value of a setting.
 * @param {string} name
 */
export function setting(name) {
  return settings[name];
}

/**
 * Change a setting; kept in this browser where it lets us.
 * @param {string} name
 * @param {*} value
 */
export function setSetting(name, value) {
  if (settings[name] === value) return;
  settings = { ...settings, [name]: value };
  write(SETTINGS, settings);
  for (const listener of listeners) listener(name, value);
}

/**
 * Be told of changed settings.
 * @param {(name: string, value: *) => void} listener
 * @returns {Function} Stops it.
 */
export function onSetting(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

// A tab keeps its person over reloads; a new tab starts as the last one on this computer did.
let identity = read(IDENTITY, areas.session) ?? read(IDENTITY) ?? { who: "", blind: false };

/** The annotator of this tab; "" until the server named its default. */
export function who() {
  return identity.who;
}

/** Whether this tab hides what others and the model said. */
export function blind() {
  return identity.blind;
}

/**
 * Choose who works here and whether blind.
 * @param {{who?: string, blind?: boolean, preset?: string}} change
 *   `preset`: the annotator that the server was started with.
 */
export function setIdentity(change) {
  identity = { ...identity, ...change };
  write(IDENTITY, identity, areas.session);
  write(IDENTITY, identity);
}

/**
 * Take the server's annotator where nobody was chosen here, or for another one of the server's.
 * @param {string} preset
 * @returns {boolean} Whether that changed who works here.
 */
export function adoptPreset(preset) {
  if (identity.preset === preset && identity.who) return false;
  const changed = Boolean(identity.who) && identity.who !== preset;
  setIdentity({ who: preset, blind: changed ? false : identity.blind, preset });
  return changed;
}
