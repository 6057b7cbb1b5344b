// A field of several lines: Enter sends it, Shift+Enter begins another line, and Escape returns the keys to the page.

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
