// @ts-check
/** The blind comparison of the robots of two methods looks like a trial, and must. */

export { mount } from "./trial.js";
