/** The panels that nobody sees first. */
export { mount as exports } from "./exports/panel.js";
export { mount as compare } from "./report/comparison.js";
export { mount as upload } from "./upload/panel.js";
