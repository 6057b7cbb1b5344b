// A menu of the toolbar's tools that do not fit into the window.

const KEY = /^(.*?)(?: \(([^()]+)\))?$/;

// Lists the hidden tools as menu items: those hidden by the style sheet, and those cut off by the button. Each item
// clicks its tool.
export function moreItems(bar, more) {
  const end = more.getBoundingClientRect().left;
  const isHidden = (el) => el.getClientRects().length === 0 || el.getBoundingClientRect().right > end + 1;
  const tools = [...bar.querySelectorAll("button, a.tool")].filter((el) => el !== more && isHidden(el));
  return tools.map((el) => {
    const [, text, hint] = KEY.exec(el.title || el.textContent.trim()) ?? [];
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
