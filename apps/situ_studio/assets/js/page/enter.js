// A field of several lines that Enter sends, as it would one line; Shift+Enter begins another line.

export const hooks = {
  Enter: {
    mounted() {
      this.el.focus();
      this.el.addEventListener("keydown", (e) => {
        if (e.key !== "Enter" || e.shiftKey) return;
        e.preventDefault();
        this.el.form.requestSubmit();
      });
    },
  },
};
