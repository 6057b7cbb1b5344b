// The module that the page loads with its first panel that shows a compressed stream.

export { openFilm } from "./film.js";
