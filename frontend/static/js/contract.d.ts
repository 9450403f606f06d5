// Made by `python -m backend.api.core.published` from the server's models; not to be edited.

/** An answer to the current step. */
export interface AnswerSent {
  /** another one per answer; the same again counts once */
  request_id: string;
  /** as the kind of step wants it */
  value?: { [key: string]: any };
  client_time?: string | null;
}

/** The acknowledgement of an answer: it is stored. */
export interface Answered {
  state: "active" | "paused" | "completed" | "withdrawn" | "expired" | "screened_out";
  step: StepState;
  language: string;
  /** where something is shown on the stage */
  stage_url?: string | null;
  accepted: true;
  /** whether the same request had stored it before */
  duplicate: boolean;
}

/** How a scene is seen: frame (x_min, y_min, x_max, y_max) must be in sight from above. */
export interface CameraOrder {
  view: "top_down" | "first_person" | "immersive";
  eye: number[];
  target: number[];
  fov_rad: number;
  frame: number[];
}

/** Let a path be drawn. */
export interface DrawOrder {
  solids: Solid[];
  person: Round;
  robot_radius: number;
  id: string;
  start: number[];
  goal: number[];
  speeds: number[];
  kept: number[][][];
  drawn: Drawn | null;
  resting: boolean;
  problem: StrokeTrouble | null;
  walks: number[][][];
  chosen: number | null;
  most_points: number;
  tight_m: number;
  type: "draw";
}

/** Where a drawing stands after a change of it. */
export interface DrawingReply {
  state: "active" | "paused" | "completed" | "withdrawn" | "expired" | "screened_out";
  step: StepState;
  language: string;
  /** where something is shown on the stage */
  stage_url?: string | null;
  problem?: StrokeProblemTold | null;
}

/** How far a drawn path is. */
export interface DrawingState {
  phase: "drawing" | "ready" | "driving" | "watched";
  /** whether the participant walks beside the rollout */
  walking: boolean;
  /** whether the robot met the participant on the last walk */
  met: boolean;
  /** the drawn path that can be kept */
  stroke: string | null;
  /** of the rollout of the drawn path */
  duration_s: number | null;
  /** what is playing now */
  playback_id: string | null;
  may_skip: boolean;
  attempts: number;
}

/** A whole stroke: points [[x, y], ...], speeds m/s wanted there, times_s of the hand. */
export interface Drawn {
  points: number[][];
  speeds: number[];
  times_s: number[];
}

/** Something could not be watched to its end. */
export interface Interrupted {
  reason: "hidden" | "webgl_lost" | "connection";
}

/** The stream's event `job`: how far the training is that a participant waits for. */
export interface JobNews {
  progress: number;
  done: boolean;
}

/** A bot's session. */
export interface Joined {
  token: string;
  participant: string;
  simulated: boolean;
}

/** The way in: a form of the welcome page, or a bot's JSON. Capital letters: ids of a recruiting platform. */
export interface Joining {
  language?: string;
  /** what the device check measured: width, height, pixel_ratio, frame_rate, pointer, touch, webgl, scheme, reduced_motion */
  device?: { [key: string]: string | number | boolean };
  simulated?: boolean;
  /** which simulated person answers; of simulated sessions only */
  oracle?: { [key: string]: any } | null;
  PROLIFIC_PID?: string | null;
  STUDY_ID?: string | null;
  SESSION_ID?: string | null;
}

/** A name beside its colour, red, green and blue up to 255. */
export interface LegendEntry {
  name: string;
  colour: number[];
}

/** The stream's event `moved`: look anew, or another window of this session is the one in use now. */
export interface Moved {
  reason: "step" | "other_window";
}

/** The nearest thing, how far the robot's edge is from it (negative: inside), and whether that room is tight. */
export interface Near {
  name: string;
  metres: number;
  tight: boolean;
}

/** Something the page noticed. */
export interface Noticed {
  kind: "stage_ready" | "stage_slow" | "visibility" | "resized" | "script_error" | "connection" | "device" | "viewed";
  data?: { [key: string]: any };
  client_time?: string | null;
}

/** A sheet of paper to draw a path on; see `paper.Paper`. */
export interface PaperOrder {
  solids: Solid[];
  person: Round;
  robot_radius: number;
  id: string;
  start: number[];
  goal: number[];
  speeds: number[];
  kept: number[][][];
  drawn: Drawn | null;
  resting: boolean;
  problem: StrokeTrouble | null;
  walks: number[][][];
  chosen: number | null;
  most_points: number;
  tight_m: number;
}

/** The event `drawing`: how the stroke stands. near: to the pen; tight: the worst place of the stroke. */
export interface PenState {
  drawing: boolean;
  can_undo: boolean;
  can_redo: boolean;
  can_finish: boolean;
  at_goal: boolean;
  length_m: number;
  seconds: number;
  speed: number;
  speeds: number[];
  near: Near | null;
  tight: Near | null;
  keys: boolean;
  problem: boolean;
  walk: number | null;
  must_choose: boolean;
}

/** clear: an empty stage; replaced: another connection took this one's place. */
export interface PlainOrder {
  type: "clear" | "replaced";
}

/** Show the label, then the motion, then hold its end; `walk`: what is around a participant who walks themselves. */
export interface PlayOrder {
  type: "play";
  playback_id: string;
  label: string;
  label_s: number;
  hold_s: number;
  tracks: number[][][];
  person: number[][] | null;
  walk: Surroundings | null;
  paper: PaperOrder | null;
}

/** What a participant writes by `report a problem`. */
export interface ProblemTold {
  text?: string;
}

/** The body of every answer with a status of 400 or more. */
export interface Refusal {
  error: Trouble;
}

/** Rollouts side by side, for analysts. */
export interface ReplayOrder {
  type: "replay";
  tracks: number[][][];
  person: number[][] | null;
  speed: number;
  loop: boolean;
  legend: LegendEntry[];
}

/** The rollout of a drawn path was watched to its end. */
export interface RolloutSeen {
  playback_id?: string | null;
  walk?: WalkSent | null;
}

/** Somebody who stands on the floor. */
export interface Round {
  name: string;
  x: number;
  y: number;
  radius: number;
}

/** A trajectory of a pair was watched to its end. */
export interface Seen {
  side: "a" | "b";
  playback_id?: string | null;
}

/** Where a session stands: what `GET /api/session/{token}` answers, and every change beside its own things. */
export interface SessionState {
  state: "active" | "paused" | "completed" | "withdrawn" | "expired" | "screened_out";
  step: StepState;
  language: string;
  /** where something is shown on the stage */
  stage_url?: string | null;
}

/** A scene has been built; say so once all of it can be seen. */
export interface ShowOrder {
  type: "show";
  camera: CameraOrder;
  meshes: string[];
  robots: string[];
  person: string;
  stands: number[];
  start: number[];
  sharpness: number;
}

/** A box on the floor; `name`: what the page's words call it. */
export interface Solid {
  name: string;
  x: number;
  y: number;
  yaw: number;
  length: number;
  width: number;
}

/** Play the first trajectory that was not seen yet. */
export interface Start {
  request_id?: string;
}

/** The current step without its texts. Simulated sessions are told more, as bots read no pages. */
export interface StepState {
  key: string;
  kind: string;
  /** counted from 0 over the steps that this person meets in this appointment */
  index: number;
  /** how many these will be, as far as it is known */
  total: number;
  trial: TrialState | DrawingState | null;
  [more: string]: any;
}

/** Why a drawn path cannot be driven. Beside these: numbers of the sentence, SI units in their names. */
export interface StrokeProblemTold {
  code: string;
  message: string;
  thing?: string | null;
  at?: number[] | null;
  after_s?: number | null;
  distance_m?: number | null;
  duration_s?: number | null;
  [more: string]: any;
}

/** A drawn path: points (n, 2) m, speeds (n,) m/s wanted there, times_s (n,) of the hand. */
export interface StrokeSent {
  /** another one per answer; the same again counts once */
  request_id: string;
  points: number[][];
  speeds: number[];
  times_s: number[];
  /** mouse, touch, pen or keys, or several with + */
  pointer?: string;
  /** which of the walks that were offered */
  walk?: number | null;
  client_time?: string | null;
}

/** What is wrong with the stroke on the paper: `at`, and which thing is touched, where that says something. */
export interface StrokeTrouble {
  code: string;
  at: number[] | null;
  thing: string | null;
}

/** What stands around a robot or a walker. */
export interface Surroundings {
  solids: Solid[];
  person: Round;
  robot_radius: number;
}

/** Both trajectories of the current trial as NPZ in base64. */
export interface TrialData {
  a: string;
  b: string;
}

/** How the trajectories of a trial are being watched. */
export interface TrialState {
  phase: "ready" | "playing_a" | "playing_b" | "choosing" | "answered";
  /** of the trajectory alone, without the letter before it */
  duration_a_s: number;
  duration_b_s: number;
  /** how long the letter stands before a trajectory */
  label_s: number;
  /** how often this trial had to begin again */
  restarts: number;
  /** how often both trajectories were watched again */
  replays: number;
  /** which one Start plays: B where only B was cut short */
  next_side: "a" | "b";
  /** what is playing now */
  playback_id: string | null;
}

/** Why a request was refused. `field`: the path to what is wrong; `value`: what was there, if it is short. */
export interface Trouble {
  code: string;
  message: string;
  field?: string | null;
  value?: string | number | boolean | null;
}

/** Walk once more beside the rollout of the path that is there. */
export interface WalkAgain {
  /** another one per answer; the same again counts once */
  request_id: string;
}

/** What a participant walked: times_s (n,), poses (n, 3) x, y, yaw in m and radians. */
export interface WalkSent {
  times_s: number[];
  poses: number[][];
}
