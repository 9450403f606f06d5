// @ts-check
/** The blind comparison looks like a trial, and must. */

export { mount } from "./trial.js";
