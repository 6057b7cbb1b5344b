// The address of what is shown, for somebody who may look and not change.

import { copy, toast } from "./toast.js";

export function copyViewerLink(app, token) {
  if (!token) return toast("There is no such link here: the studio has no token for those who may only look");
  app.address.save(true);
  const link = new URL(location.href);
  link.searchParams.set("token", token);
  return copy(link.href, "Link copied: it may look, and not change", link.href);
}
