// The tiers of a schema: tracks that depend on a parent track. Pure.

/**
 * @typedef {{track: string, attribute: string, parent: string | null, relation: string | null, depth: number}} Tier
 */

/** @param {Tier[]} tiers @param {string} track @returns {Tier | null} */
export function findTier(tiers, track) {
  return tiers.find((t) => t.track === track) ?? null;
}

// Returns the tracks in the order of the panel: children follow their parents, and siblings have the schema's order.
// Tracks without a tier are first, by their names.
/** @param {string[]} tracks @param {Tier[]} tiers @returns {string[]} */
export function orderTracks(tracks, tiers) {
  const names = new Set([...tracks, ...tiers.map((t) => t.track)]);
  /** @param {string} track @returns {string[]} */
  const withChildren = (track) => [
    track,
    ...tiers.filter((t) => t.parent === track).flatMap((t) => withChildren(t.track)),
  ];
  const place = (track) => tiers.findIndex((t) => t.track === track);
  const roots = [...names].filter((track) => findTier(tiers, track)?.parent == null).sort();
  roots.sort((a, b) => place(a) - place(b));
  return roots.flatMap(withChildren);
}

// Returns the track on which an annotation with this attribute is made: the chosen one, or the nearest tier of the same
// family that has the attribute.
/** @param {Tier[]} tiers @param {string} track @param {string | undefined} attribute @returns {string} */
export function trackFor(tiers, track, attribute) {
  const tier = findTier(tiers, track);
  if (!tier || !attribute || tier.attribute === attribute) return track;
  const root = rootOf(tiers, tier);
  const family = tiers.filter((t) => t.attribute === attribute && rootOf(tiers, t) === root);
  const near = family.find((t) => t.parent === track) ?? family[0];
  return near?.track ?? track;
}

/** @param {Tier[]} tiers @param {Tier} tier @returns {string} */
function rootOf(tiers, tier) {
  const parent = tier.parent && findTier(tiers, tier.parent);
  return parent ? rootOf(tiers, parent) : tier.track;
}

// Returns the rows of the transcription of a track: [{item, from, to, text, track, attribute}] in the order of time. A
// track whose annotations have no text is transcribed on its associated tier; rows without an annotation have no item.
export function listTranscriptRows(state, track) {
  const { tiers, items, attributes } = state;
  const target = transcriptTrack(state, track);
  if (!target) return [];
  const tier = findTier(tiers, target);
  const attribute = tier?.attribute ?? attributes.find((a) => a.kind === "text").name;
  const byTime = (a, b) => a.from - b.from;
  const own = items.filter((a) => a.track === target).sort(byTime);
  const toRow = (item, { from, to }) => ({
    item,
    from,
    to,
    text: item ? String(item.values[attribute] ?? "") : "",
    track: target,
    attribute,
  });
  if (tier?.relation !== "symbolic_association") return own.map((a) => toRow(a, a));
  const parents = items.filter((a) => a.track === tier.parent).sort(byTime);
  return parents.map((p) => toRow(own.find((a) => a.from === p.from) ?? null, p));
}

// Returns the track that gets the texts, or null if there is none.
/** @returns {string | null} */
function transcriptTrack({ tiers, attributes }, track) {
  const isText = (name) => attributes.find((a) => a.name === name)?.kind === "text";
  const tier = findTier(tiers, track);
  if (!tier) return attributes.some((a) => a.kind === "text") ? track : null;
  if (isText(tier.attribute)) return track;
  const child = tiers.find((t) => t.parent === track && t.relation === "symbolic_association" && isText(t.attribute));
  return child?.track ?? null;
}
