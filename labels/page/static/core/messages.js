// The shapes of what the server says, as labels/page/api/ makes them: types in comments, nothing
// that runs. In all modules `camera` is a camera's name, `frame` a frame's number, `cell` a patch's
// number in its frame, row by row from 0, and `label` a class's name.

/**
 * @typedef {{camera: string, frame: number}} Place
 * @typedef {Place & {cell: number}} Patch
 * @typedef {Record<string, number[]>} ByCamera Frames.
 * @typedef {{rows: number, cols: number, width: ?number}} Grid `width`: that frames are resized to.
 */

/**
 * A class of the taxonomy; `obstacle` null: it is none, as unsure and names only the store has.
 * @typedef {{name: string, obstacle: ?boolean, color: string, key: string, description: string,
 *   parent?: string}} LabelClass
 *
 * @typedef {Object} Model
 * @property {string} label    Its name and version.
 * @property {string[]} classes
 * @property {boolean[]} obstacle  Of each class.
 * @property {Record<string, number>} learnt  How many patches of each class.
 * @property {[obstacle: boolean | number, low: number, high: ?number, percent: number][]} right
 * @property {number} done     Frames that it has looked at.
 * @property {number} total
 *
 * @typedef {{what: string, done: number, total: number}} JobProgress
 * @typedef {{what: string, steps: number, step: number, state: string, progress: ?JobProgress,
 *   error: string}} Job
 */

/**
 * What undo or redo acts on.
 * @typedef {Place & {key: string, kind: string, changed: number, frames: number}} Head
 * @typedef {{undo: ?Head, redo: ?Head}} Heads
 */

/**
 * The mission; `states`: one letter a frame.
 * @typedef {Object} MissionAnswer
 * @property {string} mission
 * @property {string} pictures Changes with how pictures are made.
 * @property {Grid} grid
 * @property {Record<string, {ranges: [number, number][], count: number}>} cameras
 * @property {LabelClass[]} classes
 * @property {string} annotator
 * @property {boolean} blind
 * @property {string[]} annotators
 * @property {?Model} model
 * @property {string} fault
 * @property {string} setup    Changes with the classes and the model.
 * @property {number} event    The newest that this knows of.
 * @property {Record<string, string>} states
 * @property {Record<string, Record<string, string[]>>} given  Labels by camera and frame.
 * @property {Record<string, number>} counts
 * @property {Heads} undo
 * @property {boolean} described
 * @property {{obstacle_as?: string}} settings
 * @property {?Job} job
 * @property {[number, number][]} depths
 * @property {boolean} carries
 * @property {Record<string, string>} formats
 */

/**
 * What changed, as an acknowledgement, an event or a status says it; each may be missing.
 * @typedef {Object} News
 * @property {number} [event]
 * @property {string} [setup]
 * @property {Record<string, Record<string, string>>} [states]
 * @property {Record<string, Record<string, string[]>>} [given]
 * @property {Record<string, number>} [counts]
 * @property {string} [fault]
 * @property {?{done: number, total: number}} [model]
 * @property {{obstacle_as?: string}} [settings]
 * @property {?Job} [job]
 * @property {Heads} [undo]
 * @property {boolean} [blind]
 *
 * @typedef {News & {event: number, since: number, frames: [string, number][],
 *   noted: [string, number][]}} ChangeEvent
 * @typedef {News & {blind: boolean}} StatusEvent
 */

/**
 * @typedef {{cell: ?number, text: string, who: string, time: string}} Note `cell`: null on a frame.
 * @typedef {{model: string, classes: number[], values: number[], fault: string}} Suggestions
 *
 * The labels of one frame: `mine`, `others` and `settled` one a cell; `models`: the version whose
 * suggestion was accepted, by cell.
 * @typedef {Place & {mine: (?string)[], models: Record<number, string>,
 *   others: Record<string, (?string)[]>, settled: (?string)[], notes: Note[],
 *   suggestions: ?Suggestions}} FrameLabels
 *
 * @typedef {Patch & {theirs: ?string, yours: ?string}} Refused Somebody said something else.
 * @typedef {News & {event: number, changed: number, repeated: boolean, conflicts?: Refused[],
 *   frames?: [string, number][]}} ActionAnswer
 *
 * @typedef {Place & {score: number, why: string}} QueueEntry
 * @typedef {{ready: boolean, done: number, total: number, why_not: string,
 *   frames: QueueEntry[]}} Queue
 * @typedef {{time?: ?string, depth_m?: ?number, above_ground_m?: ?number, heading_deg?: ?number,
 *   latitude?: ?number, longitude?: ?number}} FrameInfo
 */

/**
 * @typedef {Patch & {value: ?number}} SheetPatch
 * @typedef {{total: number, by: string, ready: boolean, done: number, of: number,
 *   patches: SheetPatch[]}} SheetAnswer
 *
 * @typedef {Patch & {a: string, b: string, sure: boolean, settled: ?string,
 *   settled_by: ?string}} Conflict
 * @typedef {{n_a: number, n_b: number, n_both: number, f1: ?number}} ClassAgreement
 * @typedef {{a: string, b: string, n_a: number, n_b: number, n_both: number, n_both_sure: number,
 *   kappa: ?number, agreement: ?number, kappa_with_unsure: ?number, agreement_with_unsure: ?number,
 *   labels: string[], unknown: string[], confusion: number[][], obstacle: ?ClassAgreement,
 *   per_class: Record<string, ClassAgreement>, blind: {a: number, b: number},
 *   conflicts: Conflict[]}} Agreement
 *
 * @typedef {{name: string, of: string, patches: number, fault: string}} AuditListed
 * @typedef {Patch & {label: string, suggested: string, margin: number, reason: string,
 *   group: string, mine: ?string, settled: ?string, decided: ?string}} Doubt
 * @typedef {{name: string, of: string, rule: string, total: number, patches: Doubt[]}} Audit
 */

/**
 * @typedef {LabelClass & {labels: number, given?: boolean}} UsedClass
 * @typedef {{classes: UsedClass[], setup: string, fixed: string}} ClassesAnswer
 *
 * What a label file has; of one with unknown classes only those are told.
 * @typedef {{applied: boolean, unknown: string[], annotators: string[], labels: number,
 *   here: number, lost: string[], new: number, changed: number, unchanged: number, settled: number}} Imported
 *
 * What is answered to a GET of each path, and to a POST.
 * @typedef {{
 *   "/api/mission": MissionAnswer,
 *   "/api/labels": {event: number, frames: FrameLabels[]},
 *   "/api/carried": {labels: (?string)[]},
 *   "/api/queue": Queue,
 *   "/api/labelled": {cameras: ByCamera},
 *   "/api/frames_with": {cameras: ByCamera},
 *   "/api/frames_at": {cameras: ByCamera},
 *   "/api/frame_info": FrameInfo,
 *   "/api/sheet": SheetAnswer,
 *   "/api/agreement": Agreement,
 *   "/api/audits": {audits: AuditListed[]},
 *   "/api/audit": Audit,
 *   "/api/classes": ClassesAnswer,
 *   "/api/export": {labels: number, lost: string[]},
 *   "/api/job": {job: ?(Job & {lines: string[]})},
 * }} Answers
 * @typedef {{
 *   "/api/actions": ActionAnswer, "/api/undo": ActionAnswer, "/api/redo": ActionAnswer,
 *   "/api/seen": News, "/api/notes": {notes: Note[]}, "/api/blind": {blind: boolean},
 *   "/api/settings": {}, "/api/classes": ClassesAnswer, "/api/job": {job: ?Job},
 *   "/api/job/cancel": {job: ?Job},
 * }} Posted
 */

export {};
