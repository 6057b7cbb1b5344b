// Finds elements that the page must contain.

// Returns the element with this id. Throws if it is missing or has another class.
/**
 * @template {HTMLElement} [T=HTMLElement]
 * @param {string} id
 * @param {new () => T} [Kind]
 * @returns {T}
 */
export function getElement(id, Kind) {
  return requireElement(document.getElementById(id), `#${id}`, Kind);
}

// Returns the first element inside `root` that matches the selector. Throws if there is none, or of another class.
/**
 * @template {HTMLElement} [T=HTMLElement]
 * @param {ParentNode} root
 * @param {string} selector
 * @param {new () => T} [Kind]
 * @returns {T}
 */
export function findElement(root, selector, Kind) {
  return requireElement(root.querySelector(selector), selector, Kind);
}

/**
 * @template {HTMLElement} [T=HTMLElement]
 * @param {Element | null} element
 * @param {string} name
 * @param {new () => T} [Kind]
 * @returns {T}
 */
function requireElement(element, name, Kind) {
  if (element instanceof (Kind ?? HTMLElement)) return /** @type {T} */ (element);
  throw new Error(`the page has no ${Kind?.name ?? "element"} ${name}`);
}

// Returns the drawing context of a canvas.
/**
 * @param {HTMLCanvasElement} canvas
 * @param {CanvasRenderingContext2DSettings} [options]
 */
export function getContext2d(canvas, options) {
  const context = canvas.getContext("2d", options);
  if (!context) throw new Error("the browser has no memory for another canvas");
  return context;
}

// Returns the nearest ancestor of an event's target, or the target, that matches the selector; null if there is none.
/**
 * @param {Event} event
 * @param {string} selector
 * @returns {HTMLElement | null}
 */
export function closestTarget(event, selector) {
  return event.target instanceof Element ? event.target.closest(selector) : null;
}

// Returns the element that has the focus, or null if nothing can lose it.
export function focusedElement() {
  return document.activeElement instanceof HTMLElement ? document.activeElement : null;
}

// Returns the address of the script that is being loaded, or null in a worker, a module or a test.
export function scriptAddress() {
  const script = globalThis.document?.currentScript;
  return script instanceof HTMLScriptElement ? script.src : null;
}
