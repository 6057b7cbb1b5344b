// Lays out the graph with dagre as a compound graph. Pure: takes the server's graph and returns positions.
import dagre from "@dagrejs/dagre";

const NODE = { height: 40, least: 92, most: 230, letter: 6.6 };

export const nodeWidth = (label) =>
  Math.round(Math.min(NODE.most, Math.max(NODE.least, label.length * NODE.letter + 34)));

export function layoutGraph({ nodes, boxes, edges, way = "LR" }) {
  const g = new dagre.graphlib.Graph({ compound: true, multigraph: true });
  g.setGraph({ rankdir: way, nodesep: 30, ranksep: 38, edgesep: 16, marginx: 24, marginy: 24 });
  g.setDefaultEdgeLabel(() => ({}));
  for (const n of nodes) g.setNode(n.key, { width: nodeWidth(n.label), height: NODE.height });
  // dagre cannot place an empty cluster
  const shown = boxes.filter((b) => hasContents(b.key, nodes, boxes));
  for (const b of shown) g.setNode(b.key, { label: b.label });
  for (const n of nodes) if (g.hasNode(n.parent)) g.setParent(n.key, n.parent);
  for (const b of shown) if (g.hasNode(b.parent)) g.setParent(b.key, b.parent);
  for (const e of edges) {
    if (g.hasNode(e.from) && g.hasNode(e.to))
      g.setEdge(e.from, e.to, { width: 62, height: 30, labelpos: "c" }, e.key);
  }
  dagre.layout(g);
  const nodeRect = (key) => {
    const { x, y, width, height } = g.node(key);
    return { x: x - width / 2, y: y - height / 2, width, height };
  };
  return {
    width: g.graph().width,
    height: g.graph().height,
    nodes: new Map(nodes.map((n) => [n.key, nodeRect(n.key)])),
    boxes: new Map(shown.map((b) => [b.key, addTitleRoom(nodeRect(b.key))])),
    edges: new Map(g.edges().map((e) => [e.name, g.edge(e)])),
  };
}

// dagre reserves no space for a box's title
const TITLE = 18;
const addTitleRoom = ({ x, y, width, height }) => ({ x, y: y - TITLE + 6, width, height: height + TITLE - 6 });

function hasContents(key, nodes, boxes) {
  return (
    nodes.some((n) => n.parent === key) || boxes.some((b) => b.parent === key && hasContents(b.key, nodes, boxes))
  );
}

// Returns a smooth SVG path through dagre's points.
export function smoothPath(points) {
  if (points.length < 2) return "";
  const p = points.map(({ x, y }) => [Math.round(x * 10) / 10, Math.round(y * 10) / 10]);
  let d = `M${p[0]}`;
  for (let i = 1; i < p.length - 1; i++) {
    const mid = [(p[i][0] + p[i + 1][0]) / 2, (p[i][1] + p[i + 1][1]) / 2];
    d += i === p.length - 2 ? ` Q${p[i]} ${p[i + 1]}` : ` Q${p[i]} ${mid}`;
  }
  if (p.length === 2) d += ` L${p[1]}`;
  return d;
}
