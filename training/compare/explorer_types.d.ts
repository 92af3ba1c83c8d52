// Types of explorer.js, which no page loads: what explorer_data in comparison.py gives to the page.

/** The rule of frames; nulls: nothing stops at once. */
export interface Rule {
  margin: number;
  margin_now: number | null;
  least_patches: number;
  hits: number;
  window: number;
}

/** A rule by the steps of a model's thresholds: `step` for `margin`, `now` for `margin_now`. */
export interface StepRule extends Pick<Rule, "least_patches" | "hits" | "window"> {
  step: number;
  now: number | null;
}

export interface Model {
  /** Of each frame's patches. */
  ranks: Uint8Array;
  /** Whether the model saw a frame. */
  judged: boolean[];
  patches: number;
  /** Patches at once. */
  white: number;
  thresholds: number[];
  true_positive: number[];
  false_positive: number[];
  rule: Rule;
}

export type Sequence = { name: string, start: number, stop: number };

export interface Explorer {
  /** Their ranks are in base64. */
  models: Record<string, Omit<Model, "ranks"> & { ranks: string }>;
  sequences: Sequence[];
  obstacle: number;
  frames: { gap: number[], ocean: boolean[], obstacle: boolean[], number: number[] };
}

export type Figure = "precision" | "recall" | "f1";
