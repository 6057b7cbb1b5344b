// A field of several lines that Enter sends, as it would one line; Shift+Enter begins another line, and Escape leaves
// the field to the keys of the page.

export const hooks = {
  Enter: {
    mounted() {
      this.el.focus();
      this.el.addEventListener("keydown", (e) => {
        if (e.key === "Escape") {
          e.stopPropagation();
          return this.el.blur();
        }
        if (e.key !== "Enter" || e.shiftKey) return;
        e.preventDefault();
        this.el.form.requestSubmit();
      });
    },
  },
};
