// The tools of the toolbar that the window has no room for: a menu of them, under the button with the dots.

const KEY = /^(.*?)(?: \(([^()]+)\))?$/;

// As the menu takes them: those that the style sheet leaves out, and those behind the button. Each does what a click on
// the tool would.
export function moreItems(bar, more) {
  const end = more.getBoundingClientRect().left;
  const unseen = (el) => el.getClientRects().length === 0 || el.getBoundingClientRect().right > end + 1;
  const tools = [...bar.querySelectorAll("button, a.tool")].filter((el) => el !== more && unseen(el));
  return tools.map((el) => {
    const [, text, hint] = KEY.exec(el.title || el.textContent.trim());
    return { text, hint, disabled: el.disabled === true, run: () => el.click() };
  });
}

export const hooks = {
  More: {
    mounted() {
      this.el.addEventListener("click", () => {
        const { left, bottom } = this.el.getBoundingClientRect();
        window.situStudio?.menu.open(moreItems(this.el.closest(".topbar"), this.el), left, bottom + 4);
      });
    },
  },
};
