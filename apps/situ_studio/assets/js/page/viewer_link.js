// Copies a view-only link to the current page.

import { copyText, showToast } from "./toast.js";

export function copyViewerLink(app, token) {
  if (!token) return showToast("No view-only link available: the studio was started without a viewer token");
  app.address.save(true);
  const link = new URL(location.href);
  link.searchParams.set("token", token);
  return copyText(link.href, "View-only link copied", link.href);
}
