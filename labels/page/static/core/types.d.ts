// Types of core, and those of what the server says, as labels/page/api makes it. Editors and
// checkers read them; the page does not load this file, and the wheel does not hold it. `camera` is
// a camera's name, `frame` a frame's number, `cell` a patch's number in its frame, row by row from
// 0, and `label` a class's name.

// What the server says

export type Place = { camera: string, frame: number };

export type Patch = Place & { cell: number };

/** Frames. */
export type ByCamera = Record<string, number[]>;

/** `width`: that frames are resized to. */
export type Grid = { rows: number, cols: number, width: number | null };

/** A class of the taxonomy; `obstacle` null: it is none, as unsure and names only the store has. */
export interface LabelClass {
  name: string;
  obstacle: boolean | null;
  color: string;
  key: string;
  description: string;
  parent?: string;
}

export interface Model {
  /** Its name and version. */
  label: string;
  classes: string[];
  /** Of each class. */
  obstacle: boolean[];
  /** How many patches of each class. */
  learnt: Record<string, number>;
  right: [obstacle: boolean | number, low: number, high: number | null, percent: number][];
  /** Frames that it has looked at. */
  done: number;
  total: number;
}

export type JobProgress = { what: string, done: number, total: number };

export interface Job {
  what: string;
  steps: number;
  step: number;
  state: string;
  progress: JobProgress | null;
  error: string;
}

/** What undo or redo acts on. */
export interface Head extends Place {
  key: string;
  kind: string;
  changed: number;
  frames: number;
}

export type Heads = { undo: Head | null, redo: Head | null };

/** The mission; `states`: one letter a frame. */
export interface MissionAnswer {
  mission: string;
  /** Changes with how pictures are made. */
  pictures: string;
  grid: Grid;
  cameras: Record<string, { ranges: [number, number][], count: number }>;
  classes: LabelClass[];
  annotator: string;
  blind: boolean;
  annotators: string[];
  model: Model | null;
  fault: string;
  /** Changes with the classes and the model. */
  setup: string;
  /** The newest that this knows of. */
  event: number;
  states: Record<string, string>;
  /** Labels by camera and frame. */
  given: Record<string, Record<string, string[]>>;
  counts: Record<string, number>;
  undo: Heads;
  /** Cells that are no view in all frames of a camera. */
  masked: ByCamera;
  described: boolean;
  settings: { obstacle_as?: string };
  job: Job | null;
  depths: [number, number][];
  carries: boolean;
  /** Its frames are no sequence: none says anything of the next. */
  single_pictures: boolean;
  formats: Record<string, string>;
}

/** What changed, as an acknowledgement, an event or a status says it; each may be missing. */
export interface News {
  event?: number;
  setup?: string;
  states?: Record<string, Record<string, string>>;
  given?: Record<string, Record<string, string[]>>;
  counts?: Record<string, number>;
  fault?: string;
  model?: { done: number, total: number } | null;
  settings?: { obstacle_as?: string };
  job?: Job | null;
  undo?: Heads;
  blind?: boolean;
}

export interface ChangeEvent extends News {
  event: number;
  since: number;
  frames: [string, number][];
  noted: [string, number][];
}

export type StatusEvent = News & { blind: boolean };

/** `cell`: null on a frame. */
export interface Note {
  cell: number | null;
  text: string;
  who: string;
  time: string;
}

export interface Suggestions {
  model: string;
  classes: number[];
  /** Null where the patch is masked, or where it is clear to the model and not seen. */
  values: (number | null)[];
  fault: string;
}

/** The labels of one frame: `mine`, `others` and `settled` one a cell; `models`: the version whose
 * suggestion was accepted, by cell; `hidden`: how many labels of mine are on masked patches.
 */
export interface FrameLabels extends Place {
  mine: (string | null)[];
  models: Record<number, string>;
  others: Record<string, (string | null)[]>;
  settled: (string | null)[];
  notes: Note[];
  hidden: number;
  suggestions: Suggestions | null;
}

/** Somebody said something else. */
export type Refused = Patch & { theirs: string | null, yours: string | null };

export interface ActionAnswer extends News {
  event: number;
  changed: number;
  repeated: boolean;
  /** Patches that took no label because they are masked. */
  masked?: number;
  conflicts?: Refused[];
  frames?: [string, number][];
}

export type QueueEntry = Place & { score: number, why: string };

export interface Queue {
  ready: boolean;
  done: number;
  total: number;
  why_not: string;
  frames: QueueEntry[];
}

/** When and where a frame was taken; {}: nothing is known. */
export interface FrameInfo {
  time?: string | null;
  depth_m?: number | null;
  above_ground_m?: number | null;
  heading_deg?: number | null;
  latitude?: number | null;
  longitude?: number | null;
}

export type SheetPatch = Patch & { value: number | null };

export interface SheetAnswer {
  total: number;
  by: string;
  ready: boolean;
  done: number;
  of: number;
  patches: SheetPatch[];
}

export interface Conflict extends Patch {
  a: string;
  b: string;
  sure: boolean;
  settled: string | null;
  settled_by: string | null;
}

export interface ClassAgreement {
  n_a: number;
  n_b: number;
  n_both: number;
  f1: number | null;
}

export interface Agreement {
  a: string;
  b: string;
  n_a: number;
  n_b: number;
  n_both: number;
  n_both_sure: number;
  kappa: number | null;
  agreement: number | null;
  kappa_with_unsure: number | null;
  agreement_with_unsure: number | null;
  labels: string[];
  unknown: string[];
  confusion: number[][];
  obstacle: ClassAgreement | null;
  per_class: Record<string, ClassAgreement>;
  blind: { a: number, b: number };
  conflicts: Conflict[];
}

export interface AuditListed {
  name: string;
  of: string;
  patches: number;
  fault: string;
}

export interface Doubt extends Patch {
  label: string;
  suggested: string;
  margin: number;
  reason: string;
  group: string;
  mine: string | null;
  settled: string | null;
  decided: string | null;
}

export interface Audit {
  name: string;
  of: string;
  rule: string;
  total: number;
  patches: Doubt[];
}

export type UsedClass = LabelClass & { labels: number, given?: boolean };

export interface ClassesAnswer {
  classes: UsedClass[];
  setup: string;
  fixed: string;
}

/** What a label file has; of one with unknown classes only those are told. */
export interface Imported {
  applied: boolean;
  unknown: string[];
  annotators: string[];
  labels: number;
  here: number;
  lost: string[];
  new: number;
  changed: number;
  unchanged: number;
  settled: number;
}

/** What is answered to a GET of each path, and to a POST. */
export interface Answers {
  "/api/mission": MissionAnswer;
  "/api/labels": { event: number, frames: FrameLabels[] };
  "/api/carried": { labels: (string | null)[] };
  "/api/queue": Queue;
  "/api/labelled": { cameras: ByCamera };
  "/api/frames_with": { cameras: ByCamera };
  "/api/frames_at": { cameras: ByCamera };
  "/api/frame_info": FrameInfo;
  "/api/sight": { causes: string[] };
  "/api/sheet": SheetAnswer;
  "/api/agreement": Agreement;
  "/api/audits": { audits: AuditListed[] };
  "/api/audit": Audit;
  "/api/classes": ClassesAnswer;
  "/api/export": { labels: number, lost: string[] };
  "/api/fixed_marks": { cells: number[] | null };
  "/api/job": {job: (Job & { lines: string[], result: string[] }) | null};
}

export interface Posted {
  "/api/actions": ActionAnswer;
  "/api/undo": ActionAnswer;
  "/api/redo": ActionAnswer;
  "/api/seen": News;
  "/api/notes": { notes: Note[] };
  "/api/blind": { blind: boolean };
  "/api/settings": {};
  "/api/mask": {};
  "/api/fixed_marks": {};
  "/api/classes": ClassesAnswer;
  "/api/job": { job: Job | null };
  "/api/job/cancel": { job: Job | null };
}

// core/api.js

export type { ApiError } from "./api.js";

export type Param = string | number | null | undefined;

/** Those that are null or undefined are left out, a list is repeated. */
export type Params = Record<string, Param | Param[]>;

// core/controls.js

/** `event`: of the key or the button. */
export type Command = (event?: Event) => unknown;

/** By name. */
export type Commands = Record<string, Command>;

/** The key of a command, by the command's name. */
export type KeyFor = (command: string) => string;

/** Makes the button of a command; `text`: what stands on it; `does`: for its title. */
export type CommandButton = (
  text: string,
  name: string,
  does: string,
  options?: Options<"button">,
) => HTMLButtonElement;

/** -1: back, or smaller; 1: on, or larger. */
export type Turn = (step: number) => unknown;

/** A value as it is, or with words for it. */
export type Choice = string | [value: string, words: string];

// core/dom.js

export type Tag = keyof HTMLElementTagNameMap;

export type Listeners<T extends Tag> = {
  [E in keyof HTMLElementEventMap]?: (
    event: HTMLElementEventMap[E] & { target: HTMLElementTagNameMap[T] },
  ) => unknown;
};

/** What an element has: `text`: its words; `on`: its listeners by event. All other options are
 * attributes: true gives an empty one, false, null and undefined give none.
 */
export type Options<T extends Tag> = { text?: string, on?: Listeners<T> } & Record<string, unknown>;

/** How a sentence is shown. `bad`: something was not done; `link`: the address of the place that it
 * is about; `stays`: it is not of what is shown.
 */
export interface SayOptions {
  bad?: boolean;
  link?: string | null;
  stays?: boolean;
}

/** Null and undefined are left out. */
export type Child = Node | string | null | undefined;

/** What adds a listener, and returns what takes it away again; what tells all of them. */
export type Signal<N extends unknown[]> = [
  listen: (listener: (...news: N) => unknown) => () => void,
  tell: (...news: N) => void,
];

// core/keys.js

export interface KeyEntry {
  /** "n", "N", "?", "Enter", "Shift+Enter", "Ctrl+Z", "PageDown", "Space". */
  keys: string[];
  /** For the overlay. */
  does: string;
  /** Returning false leaves the event to the browser; without it the entry is for the overlay only.
   */
  run?: (event: KeyboardEvent, key: string) => unknown;
  /** When the key comes up again. */
  release?: (event: Event) => unknown;
  /** Heading in the overlay. */
  group?: string;
}

export interface ViewKeys {
  title: string;
  keys?: KeyEntry[];
  classKeys?: (name: string) => unknown;
}

/** What answers to keys now. */
export interface KeyTables {
  /** Of the view that is shown. */
  view: ViewKeys;
  /** What answers in every view, after the view's own. */
  everywhere: KeyEntry[];
  /** By the key's code: those that are down, to be released. */
  held: Map<string, KeyEntry>;
}

// core/mission.js

/** The mission as this page has it. `states`: one array of characters a camera; `blind`: whether
 * who works here labels blind, as the server says, which then hides what others said; `classes`: in
 * the taxonomy's order, then unsure, then names only found in the store.
 */
export interface MissionState extends Omit<MissionAnswer, "states"> {
  loaded: boolean;
  states: Record<string, string[]>;
}

/** What is derived of the mission, and counts by which answers of no use any more are told. */
export interface Derived {
  byName: Map<string, LabelClass>;
  /** The frames of each camera. */
  frames: ByCamera;
  /** Where each of `frames` stands. */
  places: Record<string, Map<number, number>>;
  /** The masked cells of each camera. */
  masked: Record<string, Set<number>>;
  settingsHeard: number;
  /** Who works here and how: the next one's is another number. */
  person: number;
}

export type Person = { who: string, blind?: boolean };

// core/patch_grid.js

/** By rows and columns; `extend` keeps the other corner of the rectangle. */
export type CursorMove = (rows: number, cols: number, extend: boolean) => void;

export type Point = { x: number, y: number };

// core/pictures.js

export interface PictureJob extends PromiseWithResolvers<ImageBitmap> {
  url: string;
  bitmap: ImageBitmap | null;
  error: unknown;
  controller: AbortController;
  started: boolean;
}

export interface PictureStore {
  /** By address, least recently asked for first. */
  jobs: Map<string, PictureJob>;
  waits: PictureJob[];
  running: number;
}

/** About the picture of a frame; `enhance`: from 0, as the camera gave it, to 100. */
export type OfPicture<T> = (camera: string, frame: number, enhance: number) => T;

export type PictureName = { camera: string, frame: number, enhance: number };

// core/router.js

/** A view, or one that is loaded when it is first shown. `under`: the view whose link stands for
 * it; `show(root, parts)` is called with the address's further words, and again when they change
 * while the view stays; `root` is emptied when another view takes over.
 */
export interface View extends ViewKeys {
  under?: string;
  link?: () => string;
  show: (root: HTMLElement, parts: string[]) => unknown;
  hide: () => void;
}

export interface LaterView {
  /** Of its link; "" for a view that others lead to. */
  title: string;
  /** `again` ends the module's address: browsers do not fetch one again that could not be had. */
  load: (again: string) => Promise<unknown>;
}

export interface ShownViews {
  views: Map<string, View | LaterView>;
  current: string;
  /** Stands for an empty or unknown address. */
  home: string;
  failures: number;
}

/** `replace`: no new entry for the Back button. */
export type GoOptions = { replace?: boolean };

// core/settings.js

/** What a person sets. */
export interface Settings {
  enhance: number;
  tint: number;
  grid: boolean;
  outlines: boolean;
  suggestions: boolean;
  drawer: boolean;
  confidence: number;
  follow: number;
  filter: string;
  rate: number;
  beside: boolean;
  selected: string;
  /** Whose frames are labelled blind. */
  blindOf: string;
  /** 0: as many as usual. */
  overviewColumns: number;
  tileWidth: number;
  tileMargin: number;
}

export type SettingName = keyof Settings;
