// A multi-line field: Enter submits it, Shift+Enter adds a line, and Escape returns the focus to the page.

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
