// For `tsc --checkJs`: what our scripts share, each made by the file of its name, and viser's window into itself.
type Orders = {
  camera: import("../../../frontend/static/js/contract.js").CameraOrder;
  show: import("../../../frontend/static/js/contract.js").ShowOrder;
  draw: import("../../../frontend/static/js/contract.js").PaperOrder;
  play: import("../../../frontend/static/js/contract.js").PlayOrder;
  replay: import("../../../frontend/static/js/contract.js").ReplayOrder;
  any:
    | import("../../../frontend/static/js/contract.js").ShowOrder
    | import("../../../frontend/static/js/contract.js").DrawOrder
    | import("../../../frontend/static/js/contract.js").PlayOrder
    | import("../../../frontend/static/js/contract.js").ReplayOrder
    | import("../../../frontend/static/js/contract.js").NumberedPaths
    | import("../../../frontend/static/js/contract.js").PlainOrder;
};
type Solid = import("../../../frontend/static/js/contract.js").Solid;
type Round = import("../../../frontend/static/js/contract.js").Round;
type Surroundings = import("../../../frontend/static/js/contract.js").Surroundings;
type DrawnStroke = import("../../../frontend/static/js/contract.js").Drawn;
type LivePath = import("../../../frontend/static/js/contract.js").LivePath;
type MirrorOrder = import("../../../frontend/static/js/contract.js").MirrorOrder;
type PenState = import("../../../frontend/static/js/contract.js").PenState;
/** Rows of [t, x, y, yaw], s, m and radians. */
type Track = number[][];
/** The nearest thing, how far the robot's edge is from it (negative: inside), and the nearest point of it. */
type NearThing = { name: string; metres: number; at: number[] };
/** A stretch of a path that is tight, as indices; `worst` is the tightest point. */
type TightStretch = { from: number; to: number; worst: number; near: NearThing };
type Measured = {
  points: number[][]; speeds: number[]; nears: NearThing[]; tight: TightStretch[]; length: number; seconds: number;
};
type Finds = (x: number, y: number, t: number) => NearThing;
/** fit: make it as large as the window, empty, in CSS pixels; due: whether it may be painted anew. */
type Overlay = {
  canvas: HTMLCanvasElement; pen: CanvasRenderingContext2D;
  fit(): void; size(): number[]; due(): boolean; projector(): Projector; uncover(project: Projector): void;
};
/** How canvases lie on the floor: pixels, pixels of the picture per pixel, and where a place on the floor is on them. */
type Lying = { width: number; height: number; density: number; project: Projector };
type Projector = (x: number, y: number, z?: number) => number[] | null;
/** A button of the panel that who wears a headset sees; a resting one cannot be pressed, a tool is not the step's own. */
type RoomButton = {
  id: string; text: string; letter?: boolean; main?: boolean; resting?: boolean; tool?: boolean; pressed?: boolean; slides?: boolean;
};
/** A slider (share: where it stands, 0 to 1; less, itself, more) or points of a scale (share null), whose ends have names. */
type RoomRow = { text: string; share: number | null; buttons: RoomButton[]; ends: string[] | null };
/** quiet: a line alone, while a robot drives; beside: it leaves free what is ahead. */
type RoomPanel = {
  count: string; text: string; hint: string; buttons: RoomButton[]; rows: RoomRow[]; quiet: boolean; beside: boolean; progress: number | null;
};
/** held: it comes from a hand; floor: where it meets the floor, if that matters. */
type RoomRay = { from: number[]; along: number[]; held: boolean; floor?: number[] | null };
type RoomLabel = { at: number[]; text: string; on: boolean };
type KeyPressed = { key: string; shiftKey?: boolean; ctrlKey?: boolean; metaKey?: boolean; altKey?: boolean };

interface DesirePath {
  bridge: {
    post(type: string, detail?: object): void;
    state: { connected: boolean; ready: boolean; webgl: boolean; playback_id: string | null; keys?: StageKeys };
  };
  frames: { next(action: () => void): void; use(session: any): void };
  sound: {
    at(x: number, y: number, yaw: number): void;
    heard(): { on: boolean; state: string; gain: number; hz: number; place: number[] } | null;
    obey(message: any): void;
  };
  headPose: {
    ask(wanted: boolean): void;
    begin(): void;
    moves(at: number): void;
    flush(): void;
    see(transform: any, turned: (axis: number[]) => number[]): void;
  };
  headset: {
    use(next: Orders["camera"], meshes: string[]): void;
    worn(): boolean;
    needed(): boolean;
    head(): { x: number; y: number; yaw: number } | null;
    carry(by: number[]): void;
    back(): void;
    begin(): void;
    report(): object | null;
    obey(message: any): void;
  };
  headsetHands: {
    floorUnder(ray: { from: number[]; along: number[] }): number[] | null;
    down(source: any, ray: RoomRay | undefined): void;
    up(source: any): void;
    takes(source: any): boolean;
    move(rays: Map<any, RoomRay>): void;
    release(): void;
    sticks(sources: any[], seconds: number, snaps: boolean): { turn: number; moves: boolean };
  };
  headsetRoom: {
    build(name: string): boolean;
    clear(): void;
    show(next: RoomPanel): void;
    legend(entries: { name: string; colour: number[]; hollow?: boolean }[]): void;
    shown(): RoomPanel;
    pointed(): string[];
    may(id: string): boolean;
    draw(eye: number[], along: number[], rays: RoomRay[], dark: number): string[];
    find(eye: number[], along: number[], robot: number[]): void;
    found(): number;
    narrow(eye: number[], along: number[], share: number): void;
    darkness(): number;
    narrowed(): number;
    label(eye: number[], labels: RoomLabel[]): void;
    labels(): string[];
    meet(from: number[], along: number[]): { metres: number; button: RoomButton | null; share: number } | null;
    place(id: string): number[] | null;
    point(ids: string[], share: number): void;
  };
  overlay(id: string): Overlay;
  quads: {
    add(a: number[], b: number[], by?: number): number[];
    dot(a: number[], b: number[]): number;
    cross(a: number[], b: number[]): number[];
    unit(a: number[]): number[];
    use(name: string): boolean;
    make(order: number, hides?: boolean): any;
    picture(mesh: any, canvas: HTMLCanvasElement): void;
    put(mesh: any, at: number[], x: number[], y: number[]): void;
    drop(mesh: any): void;
  };
  headsetFloor: {
    lies(): Lying | null;
    lay(camera: Orders["camera"]): void;
    lift(): void;
    due(canvas: HTMLCanvasElement): boolean;
    painted(canvas: HTMLCanvasElement): void;
    draw(): void;
  };
  viser: {
    isUp(): boolean;
    hasMesh(name: string): boolean;
    pose(name: string, x: number, y: number, yaw: number): void;
    look(view: { eye: number[]; target: number[]; up: number[]; fovRad: number; near?: number }): void;
    projector(): Projector;
    floorAt(px: number, py: number): number[] | null;
    ray(px: number, py: number): { eye: number[]; along: number[] };
    meshes(name: string): any[];
    tint(name: string, factor: number, figure: number): void;
    gait(name: string): number[];
    redraw(): void;
    eyes(): number[];
    drawing(): { gl: any; root: any };
    world(): any;
    toView(point: number[]): number[];
    fromView(point: number[]): number[];
    wear(colour: number[] | null): void;
    orbit(free: boolean): void;
    plainPicture(sharpness: number): void;
    stopReconnecting(): void;
  };
  camera: {
    use(next: Orders["camera"]): void;
    recentre(): void;
    watch(x: number, y: number): void;
    watched(): number[];
    mayTurn(): boolean;
    gaze(at: number[] | null): void;
    look(): void;
    isLeft(x: number, y: number): boolean;
    turn(left: number, up: number): void;
    heading(): number;
    walk(on: boolean): void;
    stand(x: number, y: number): void;
    fit(): void;
    hold(): void;
    release(): void;
  };
  scheme: {
    use(meshes: string[]): void;
    isDark(): boolean;
    trail(): number[];
    colour(name: string): string;
  };
  bodies: {
    use(robots: string[], people: string[], robotSize: number[]): void;
    put(name: string, x: number, y: number, yaw: number): void;
    uncover(pen: CanvasRenderingContext2D, project: Projector): void;
  };
  trail: { use(name: string): void; at(track: Track, t: number): void };
  finder: { rest(): void; look(x: number, y: number): void };
  sheet: {
    element: HTMLElement;
    strip: HTMLElement;
    covered(): number;
    label(text: string, keeps?: number[][]): void;
    legend(entries: { name: string; colour: number[]; hollow?: boolean }[]): void;
  };
  pictures: {
    use(sheets: Orders["replay"]["pictures"]): void;
    at(t: number): void;
  };
  player: {
    along(track: Track, t: number): number[];
    use(names: string[], who?: string, where?: number[], people?: Orders["show"]["crowd"], aim?: number[] | null): void;
    /** x, y, yaw of everybody in the crowd now. */
    walkers(): number[][];
    walkTo(walked: Track, t: number): void;
    /** Who walks is where they are after so many seconds. */
    walkCrowdTo(seconds: number): void;
    place(i: number, where: number[], watched: boolean): void;
    play(order: Orders["play"]): void;
    rest(start: number[]): void;
    still(seconds: number): void;
    end(pose: number[]): void;
    replay(order: Orders["replay"]): void;
    interrupt(reason: string): void;
  };
  clearance: {
    toSolid(solid: Solid, x: number, y: number): { metres: number; at: number[] };
    of(place: Surroundings, personAt?: (t: number) => number[]): Finds;
    tight(nears: NearThing[], least: number): TightStretch[];
  };
  ink: {
    say(key: string, values?: Record<string, unknown>): string;
    number(value: number, digits: number): string;
    use(given: Record<string, any>): void;
    speeds(low: number, high: number): void;
    speed(speed: number): void;
    show(shown: boolean): void;
    paint(picture: any): void;
  };
  sections: {
    apart(a: number[], b: number[]): number;
    end(): number[];
    measure(): Measured;
    any(): boolean;
    isOpen(): boolean;
    canUndo(): boolean;
    canRedo(): boolean;
    begin(from: number[], drawn: DrawnStroke | null, given: { most_points: number; tight_m: number }): void;
    measureBy(finds: Finds): void;
    put(): void;
    add(point: number[], speed: number, time: number): void;
    lift(): boolean;
    drop(): void;
    straightTo(to: number[], speed: number, time: number): boolean;
    undo(): boolean;
    redo(): boolean;
    clear(): void;
    cutBefore(at: number[]): void;
    stroke(): DrawnStroke;
  };
  draw: {
    KEYS: string[];
    begin(given: Orders["draw"]): void;
    rest(): void;
    stop(): void;
    obey(message: any): void;
    press(event: PointerEvent): boolean;
    waits(): boolean;
    hand: { put(found: number[], pointer: string): boolean; move(found: number[]): void; lift(): void; faster(steps: number): void };
    key(event: KeyPressed): boolean;
  };
  mirror: { show(order: MirrorOrder): void; press(place: number[]): boolean; stop(): void };
  steer: {
    obey(message: any): void;
    stop(): void;
  };
  walk: {
    KEYS: string[];
    begin(given: Surroundings): void;
    stop(): void;
    advance(t: number, robotAt: (t: number) => number[]): { x: number; y: number; yaw: number; met: boolean };
    recording(): { times_s: number[]; poses: number[][] };
    lean(right: number, ahead: number): void;
    astray(eyes: number[]): number;
    key(event: KeyPressed, down: boolean): boolean;
    release(): void;
  };
  rays: {
    cast(place: { solids: Solid[]; person: Round; range_m: number }, x: number, y: number, yaw: number, bearings: number[]): Float64Array;
  };
  attention: {
    use(given: NonNullable<Orders["show"]["explained"]>["attention"]): void;
    at(t: number, x: number, y: number, yaw: number): void;
    hide(on: boolean): void;
  };
  explained: {
    use(given: Orders["show"]["explained"]): void;
    begin(): void;
    idle(pose: number[]): void;
    at(t: number, x: number, y: number, yaw: number): void;
    hide(on: boolean): void;
    follow(): void;
    halt(): RoomLabel | null;
    sign(): { x: number; foot: number; width: number; height: number }[];
    objects(): import("../../../frontend/static/js/contract.js").ExplainedObject[];
    obey(message: any): void;
  };
  picking: {
    press(from: number[], along: number[]): boolean;
    labels(rays: RoomRay[]): RoomLabel[];
    stop(): void;
    obey(message: any): void;
  };
  run(order: Orders["any"]): void;
}
/** Keys that the pen and the feet take, for the page that may have the focus instead. */
type StageKeys = { pen: string[]; feet: string[] };

interface Window {
  desirePath: DesirePath;
  desirePathConfig: { pageOrigin: string };
  __viserMutable: any;
}
