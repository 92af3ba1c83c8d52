// Types that the rooms above core share, with those of core; see core/types.d.ts.

import type {
  ByCamera, Command, FrameLabels, Grid, Head, KeyEntry, LabelClass, Patch, Place, Refused,
  SheetAnswer, SheetPatch, Turn,
} from "./core/types.js";
import type { PatchCursor } from "./core/patch_grid.js";
import type { Beside } from "./frame/beside.js";
import type { FrameCanvas } from "./frame/frame_canvas.js";
import type { FrameShow } from "./frame/frame_show.js";
import type { Player } from "./frame/play.js";
import type { Timeline } from "./frame/timeline.js";
import type { OverviewBar } from "./overview/overview_bar.js";
import type { Thumb } from "./overview/thumb.js";
import type { TileGrid, TileSelection } from "./sheets/tile_grid.js";

export type * from "./core/types.js";
export type { FrameCanvas, FrameShow, Thumb };
export type { Viewport } from "./frame/viewport.js";

/** Words by what they stand for. */
export type Words = Record<string, string>;

// saving/labels.js

/** What an action changes. */
export type OwnLabels = Pick<FrameLabels, "mine" | "settled" | "models">;

/** Whether a change holds for a cell. */
export type Holds = (cell: number) => boolean;

/** `pending`: cells that the server has not acknowledged. */
export type ShownLabels = FrameLabels & { pending: Set<number> };

export type Batch = { frames: number[] } & PromiseWithResolvers<unknown>;

/** What is known of frames, each by its key. */
export interface KnownLabels {
  /** Least recently used first. */
  truths: Map<string, FrameLabels & { event: number }>;
  /** The event up to which a frame must be read again. */
  stale: Map<string, number>;
  loading: Map<string, Promise<unknown>>;
  /** By camera: what is asked for at the end of this turn. */
  wanted: Map<string, Batch>;
  generation: number;
  modelDone: number;
}

// saving/live.js

export interface LiveState {
  source: EventSource | null;
  tries: number;
  timer: number;
  opened: boolean;
}

// saving/outbox.js

/** An action of the page: what is kept in the browser and sent. */
export interface Entry {
  /** Unique; the server counts it once. */
  key: string;
  path: "/api/actions" | "/api/undo" | "/api/redo";
  who: string;
  blind: boolean;
  mission: string;
  /** As the server names it. */
  grid: Grid;
  /** What the person did, for messages; "confirm" also says what holds already. */
  kind: string;
  /** "human" or "settled". */
  source: string;
  /** UTC. */
  time: string;
  /** Key of the action that an undo or redo is meant for. */
  target: string | null;
  /** Of an undo: the opposite ones, where this page knows them. */
  changes: Change[];
  /** Why the server refused it; null while it waits. */
  refusal: string | null;
  /** Its name in the storage. */
  stored?: string | null;
}

export interface Change {
  camera: string;
  frame: number;
  label: string | null;
  /** Version of the model whose suggestion was confirmed. */
  model: string | null;
  cells: number[];
  /** What the page believed each cell's label was. */
  base: (string | null)[];
}

/** A patch that was not written, with what there is now and what the page said. */
export interface NotedConflict extends Refused {
  who: string;
  mission: string;
  source: string;
  stored: string;
  kept?: boolean;
}

/** The actions that wait. */
export interface WaitingEntries {
  queue: Entry[];
  /** The same by the frames that they change. */
  byFrame: Map<string, Entry[]>;
  page: string;
  /** Of entries kept so far. */
  count: number;
}

/** What was not written. */
export interface Unwritten {
  /** What the server refused, each with its `refusal`. */
  aside: Entry[];
  /** What is in this browser of another mission's or another person's. */
  foreign: Entry[];
  /** To decide. */
  conflicts: NotedConflict[];
}

// saving/saver.js

export type SaveState = "saved" | "saving" | "offline" | "refused";

export interface Wanted extends Omit<Change, "model" | "base"> {
  model?: string | null;
  base?: (string | null)[];
}

export interface SaverState {
  idleWaiters: (() => void)[];
  running: boolean;
  connected: boolean;
  trouble: { state: "offline" | "refused", text: string } | null;
  /** What the server shows instead of this page's mission. */
  stranger: string;
  tries: number;
  retryTimer: number;
  /** The store's events that this page's own actions made: what they say is known here already. */
  ownEvents: { before: number, last: number }[];
  /** Keys of actions that may still be withdrawn. */
  held: Set<string>;
  /** When actions were done, by key. */
  starts: Map<string, number>;
}

/** The server's history, ahead of its acknowledgements: its ends, as this page knows them. */
export interface KnownHistory {
  undoable: Head[];
  redoable: Head[];
  /** Actions of this page by key. */
  known: Map<string, { changes: Change[], source: string }>;
  steps: Promise<Head | null>;
}

/** `source`: as of an Entry; `hold`: not sent for a moment, so that it can be withdrawn. */
export type ActOptions = { source?: string, hold?: boolean };

/** A patch, the label it shall have, and the one it is shown with. */
export interface LabelledPatch extends Patch {
  label: string | null;
  base: string | null;
  model?: string | null;
}

// labelling/blind_list.js

export interface BlindList {
  /** In the mission's order; null while they are not known. */
  frames: Place[] | null;
  /** "camera/frame" */
  names: Set<string>;
  /** Whose frames they are. */
  of: string;
  asking: Promise<{ cameras: ByCamera }> | null;
}

// labelling/cell_drawing.js

/** Of a canvas. */
export type Context = CanvasRenderingContext2D;

/** `ink`: the text's colour. */
export type DrawText = (ctx: Context, text: string, x: number, y: number, ink: string) => void;

export type Box = { x: number, y: number, width: number, height: number };

/** What it is drawn onto: `plan` in all functions here; `ctx`: scaled so that one unit is one CSS
 * pixel.
 */
export interface CellPlan {
  ctx: CanvasRenderingContext2D;
  boxOf: (cell: number) => Box;
}

/** `mark`: "?" where the model is not confident, "→" where the frame before says so and not the
 * model, "≠" where the model says the opposite.
 */
export interface ShownCell {
  label: string;
  line: "solid" | "dashed" | "dotted";
  mark: string;
}

// labelling/drawer.js

export type NumberSetting = "enhance" | "tint" | "confidence" | "follow";

// labelling/filters.js

/** Whether a filter lets a frame through. */
export type Passes = (camera: string, frame: number) => boolean;

// labelling/frame_states.js

/** What frames in a state look like; `height`: part of the strip's. */
export type FrameLook = { words: string, colour: string, height: number };

// labelling/painting.js

/** `cells`: these only; `all`: also those below the threshold. */
export type AcceptOptions = { cells?: number[], all?: boolean };

/** `left`: how many stay as they are; `waits`: what the model says is not known yet. */
export type Rest = { cells: number[], left: number, waits: boolean };

/** A proposal for a patch without a label of mine; `strong`: taken by "accept the confident ones";
 * `kept`: from the frame before; `model`: the version to record; `said`: what the model says;
 * `against`: the proposal is of another kind.
 */
export interface Hint {
  label: string;
  text: string;
  percent: number | null;
  strong: boolean;
  kept: boolean;
  model: string | null;
  said: string | undefined;
  against: boolean;
}

// labelling/suggest.js

/** What the model alone says of a patch; `named`: by a class of the taxonomy; `obstacle`: whether
 * it is one to the model; `known`: not where that is clear and the patch is not seen.
 */
export interface Says {
  label: string;
  value: number;
  named: boolean;
  obstacle: boolean;
  known: boolean;
}

/** What holds; `mine`: it goes back to what a person said. */
export type Held = { label: string, mine: boolean };

/** `value`, `percent` and `said` are the model's, also where the suggestion was kept from the frame
 * before; `against`: it is of another kind than `said`.
 */
export interface Suggestion {
  label: string;
  value: number;
  percent: number | null;
  confident: boolean;
  said: string;
  against: boolean;
}

// labelling/toolbar.js

export type Tool = [command: string, words: string, does: string];

export interface PainterRow extends Partial<LabelClass> {
  name: string;
  depth?: number;
  group?: boolean;
}

export interface PainterButton {
  name: string;
  group?: boolean;
  depth?: number;
  on: boolean;
  colour: string;
  sign: string;
  title: unknown[];
  disabled: boolean;
}

// frame/frame_canvas.js

/** What is drawn; `dim`: the picture is of before; `plain`: the picture and grid only; `pending`:
 * cells that are not saved; `tag` is handed to `onDrawn`.
 */
export interface FrameContent {
  bitmap: ImageBitmap | null;
  dim?: boolean;
  labels: ShownLabels | null;
  hints: (Hint | null)[];
  message: string;
  badge: string;
  cursor?: number | null;
  selection?: number[];
  stroke?: { cells: Iterable<number>, label: string | null } | null;
  plain?: boolean;
  masked: Set<number>;
  unseen?: number[];
  pending?: Iterable<number>;
  tag?: string | null;
}

/** A point of the canvas in patches; `cell` -1 outside of all; `head`: of the row or column whose
 * head was hit.
 */
export interface Hit {
  x: number;
  y: number;
  cell: number;
  head: { row?: number, col?: number } | null;
}

// frame/frame_commands.js

/** By name; `release`: what follows when the key comes up. */
export type HeldCommands = Record<string, Command & Pick<KeyEntry, "release">>;

// frame/frame_keys.js

export type KeyRow = [command: string, keys: string[], group: string, does: string];

// frame/frame_painting.js

export type FrameTool = "paint" | "erase" | "confirm" | "mask";

export type How = FrameTool | "unsure";

// frame/frame_state.js

/** What is on the page while the view is shown. */
export interface FramePage {
  root: HTMLElement;
  canvas: FrameCanvas;
  /** The canvas's own. */
  element: HTMLElement;
  /** The line of words. */
  status: HTMLElement;
  show: FrameShow;
  beside: Beside;
  timeline: Timeline;
  player: Player;
  pointer: PointerGestures;
  tools: { show: (chosen: string) => void };
  mask: { show: () => void };
  toggles: HTMLButtonElement[];
  drawer: { show: (said: string) => void };
  bar: { number: HTMLInputElement, show: (camera: string, frame: number) => void };
  /** What ends listening to news. */
  stops: (() => void)[];
  /** What is proposed for each patch. */
  hints: (Hint | null)[];
  /** The cell under the pointer; -1: none. */
  hovered: number;
  /** When and where the frame was taken, in words. */
  info: string;
  timers: Record<string, number | undefined>;
  /** As it was shown last. */
  savedState?: SaveState;
  /** When the address was changed last. */
  noted?: number;
}

/** All of the view's state. */
export interface FrameState {
  /** Null while another view is shown. */
  page: FramePage | null;
  /** What the chosen tool does. */
  tool: FrameTool;
  /** What is not saved of each camera's mask: whether a patch is to be masked. */
  drafts: Record<string, Map<number, boolean>>;
  /** Why this frame is shown, where it was asked for. */
  why: string;
  /** While the space bar is down. */
  space: { panned: boolean } | null;
  /** Where the person was, to come back to. */
  last: Place | null;
  cursor: PatchCursor;
}

// frame/gestures.js

export type PointerTool = "chosen" | "unsure" | "confirm";

export interface Host {
  canPaint: () => boolean;
  /** Whether the pan key is held. */
  panning: () => boolean;
  /** A pan began while the pan key was held. */
  panned: () => void;
  /** What a stroke would put; for showing. */
  labelOf: (tool: PointerTool) => string | null;
  finish: (cells: number[], tool: PointerTool, kind: string) => void;
  hover: (cell: number) => void;
}

export interface Gesture {
  move: (event: PointerEvent) => void;
  finish?: () => void;
}

/** `complete`: what was done so far counts, and the rest of the gesture does nothing. */
export interface PointerGestures {
  cancel: () => void;
  complete: () => void;
  busy: () => boolean;
}

// frame/play.js

export type ShowFrame = (camera: string, frame: number) => void;

// overview/overview_bar.js

/** What the bar's buttons do. */
export interface BarCommands {
  accept: (all: boolean) => void;
  rest: () => void;
  turn: Turn;
  resize: Turn;
  otherCamera: () => void;
}

// overview/overview_state.js

/** Patches by what would happen to them; `waiting`: frames of which that is not known. */
export interface Tally {
  strong: number;
  weak: number;
  open: number;
  waiting: number;
}

/** The elements on show. */
export interface Parts {
  host: HTMLElement;
  root: HTMLElement;
  list: HTMLElement;
  bar: OverviewBar;
  resized: ResizeObserver;
}

/** What is shown of a camera from a frame on. */
export interface Sheet {
  camera: string;
  first: number;
  /** A frame to see, whatever is filtered. */
  asked: number | null;
  /** Frames that are left out. */
  excluded: Set<number>;
  thumbs: Thumb[];
  /** Thumbnails that fit. */
  count: number;
  /** Of each one's picture, in CSS pixels. */
  width: number;
  /** The thumbnail that the keyboard is on. */
  focus: number;
  /** The patch there. */
  cell: number | null;
  /** That goes on. */
  stroke: { cells: Cells, label: string } | null;
  /** By the stroke. */
  touched: Set<Thumb>;
  /** The filter. */
  passes: Passes;
}

/** All of the view's state. */
export interface OverviewState {
  /** Null while another view is shown. */
  parts: Parts | null;
  /** Null until the shape of its pictures is known. */
  page: Sheet | null;
  /** The one asked for last: where the person was, to come back to. */
  last: Sheet | null;
  /** The key of what was painted since the button went down. */
  painted: string | null;
  /** The same of clicks that follow one another, as those of a double click. */
  clicks: (string | null)[];
}

// overview/thumb.js

/** `onShape`: the picture has another shape than was believed; `onPicture`: it is there, or not. */
export type ThumbHost = { onShape: () => void, onPicture: () => void };

/** `painted`: cells of a stroke that goes on; `cursor`: cell of the keyboard's cursor. */
export interface ThumbMarks {
  excluded: boolean;
  painted: Map<number, string> | null;
  cursor: number | null;
}

/** What a frame shows; `waits`: the model has not come to it. */
export interface ThumbContent {
  mine: (string | null)[];
  hints: (Hint | null)[];
  waits: boolean;
  fault: string;
  noted: boolean;
}

// overview/thumb_painting.js

export type Cells = Map<Thumb, Set<number>>;

/** `thumbAt`: the thumbnail whose picture is there; `allThumbs`: those that a stroke with Ctrl
 * paints; `onStroke`: show what is being painted, null: nothing any more; `onPainted`: it is done,
 * `own`: the cells that the pointer itself passed.
 */
export interface StrokeHost {
  thumbAt: (x: number, y: number) => Thumb | null;
  allThumbs: (start: Thumb) => Thumb[];
  onStroke: (stroke: Cells | null, button: number) => void;
  onPainted: (stroke: Cells, button: number, own: Cells) => void;
}

// sheets/agreement_tables.js

export type Pair = { a: string, b: string };

export type ChoosePair = (pair: Pair) => void;

// sheets/sheet_view.js

export type SheetTile = SheetPatch & { mine: string | null };

/** What is shown of the sheet; `newOrder`: there is a better order. */
export interface SheetPage extends Omit<SheetAnswer, "patches"> {
  offset: number;
  tiles: SheetTile[];
  newOrder?: boolean;
}

// sheets/tile_grid.js

/** A tile in words and what stands under its picture. */
export type Described = { name: string, lines: Node[], faded?: boolean };

/** What shows a grid; `showSelection()`: selection or cursor changed; `open(tile)`: it was double
 * clicked.
 */
export interface GridHost<T extends Patch> {
  describe: (tile: T) => Described;
  showSelection: () => void;
  open: (tile: T) => void;
}

/** Width in CSS pixels, margin around each patch in patches. */
export type TileSize = { width: number, margin: number };

export type Selecting = Pick<TileGrid<Patch>, "select" | "columns">;

export type SelectionChange = (
  selection: TileSelection,
  event: KeyboardEvent,
  grid: Selecting,
) => unknown;

// sheets/tile_pictures.js

/** In pixels. */
export interface Rectangle {
  left: number;
  top: number;
  width: number;
  height: number;
}

/** How tiles look: a size in CSS pixels and a margin around each patch in patches. */
export type Look = { width: number, height: number, margin: number };

export interface Chunk {
  sprite: string;
  elements: HTMLElement[];
  look: Look;
  image: HTMLImageElement | null;
}

// sheets/tile_sheet.js

/** A patch as the server named it, with what was said of it then. */
export type SaidPatch = Patch & { mine?: string | null, settled?: string | null };

/** Where a person is in a sheet: what is shown, from which patch on, the one pointed at. */
export interface SheetPlace {
  which: string;
  first: number;
  at: Patch | null;
  only?: { a: string, b: string } | null;
  unsure?: boolean | null;
}

/** How a sheet to decide on looks. `label`: what its grid holds; `filters`: what is filtered, for
 * screen readers; `decided`: the word for patches that are not open; `margin`: around each patch,
 * in patches; `place`: where the person was, or nothing.
 */
export interface DecisionOptions {
  label: string;
  filters: string;
  decided: string;
  margin: number;
  place?: Partial<SheetPlace> | null;
}

// files/class_editor.js

export type Field = "name" | "color" | "key" | "obstacle" | "parent" | "description";

// files/files_view.js

/** Reads the chosen file. */
export type Read = (named: Record<string, string>, apply?: boolean) => void;
