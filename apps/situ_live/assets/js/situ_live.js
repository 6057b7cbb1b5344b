// The browser part of situ_live in addition to the stock clients: the hook that acknowledges diffs, and the callback
// that keeps the entries of forms.

// The server sends one unrequested diff at a time and marks it with the event "situ:ack". The reply tells it that
// the page has applied the diff.
export const SituFlow = {
  mounted() {
    this.handleEvent("situ:ack", () => this.pushEvent("situ:ack", {}));
  },
};

// The `params` of the LiveSocket: this page acknowledges diffs.
export const connectParams = { situ_flow: "1" };

// The `dom` option of the LiveSocket: a patch keeps the entries of a form that the server receives only when it is
// submitted. The stock client keeps the focused field and resets the others. A value that the server changes
// replaces the entry.
export const domCallbacks = {
  /**
   * @param {Element} from
   * @param {Element} to
   */
  onBeforeElUpdated(from, to) {
    if (!isField(from) || !isField(to) || !from.form || from.form.hasAttribute("phx-change")) return;
    const entry = readEntry(from);
    if (entry === readInitial(from) || readInitial(from) !== readInitial(to)) return;
    // The patch is complete before the microtask runs. It sets no attributes, since they hold the server's values.
    queueMicrotask(() => writeEntry(from, entry));
  },
};

/** @typedef {HTMLInputElement | HTMLTextAreaElement | HTMLSelectElement} Field */

/**
 * @param {Element} element
 * @returns {element is Field}
 */
function isField(element) {
  return element.matches("input:not([type=hidden], [type=file]), textarea, select:not([multiple])");
}

/**
 * @param {Field} field
 * @returns {field is HTMLInputElement}
 */
function isCheckable(field) {
  return field instanceof HTMLInputElement && ["checkbox", "radio"].includes(field.type);
}

/** @param {Field} field */
const readEntry = (field) => (isCheckable(field) ? field.checked : field.value);

/** @param {Field} field */
function readInitial(field) {
  if (isCheckable(field)) return field.defaultChecked;
  if (!(field instanceof HTMLSelectElement)) return field.defaultValue;
  const options = [...field.options];
  return (options.find((option) => option.defaultSelected) ?? options[0])?.value ?? "";
}

/**
 * @param {Field} field
 * @param {boolean | string} entry
 */
function writeEntry(field, entry) {
  if (isCheckable(field)) field.checked = entry === true;
  else field.value = String(entry);
}
