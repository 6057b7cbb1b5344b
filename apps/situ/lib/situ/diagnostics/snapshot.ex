defmodule Situ.Diagnostics.Snapshot do
  @moduledoc """
  A pipeline at one moment: its graph with every statistic. It contains only plain structs, lists, numbers and
  strings, no pids, references or functions, so that it can be stored, sent and drawn.

    * `pipeline`: name; `state`: `:building | :starting | :running | :stopping | :completed`
    * `time`: pipeline clock, ns; `start_time`; `progress`: 0.0 to 1.0
    * `scopes`: paths of the composites, outer composites first (`["Mouth", "Mouth.Crop"]`); each is drawn as a box
    * `nodes`: `Situ.Diagnostics.Node`; `edges`: `Situ.Diagnostics.Edge`, joined by node ids
    * `processes`: structs with `number`, `pid` (a string, `""` once it has ended), `nodes` (paths of its nodes, in
      order), `memory` (bytes), `mailbox` (messages waiting), `reductions` (total), `status` (`"waiting"`, `"running"`
      ...) and `busy_in` (the function that it is executing, as a string; shows where a component is stuck). Nodes that
      share a process (chained operators) have the same process number
  """
  defstruct pipeline: nil,
            state: :building,
            time: 0,
            start_time: 0,
            progress: 0.0,
            scopes: [],
            nodes: [],
            edges: [],
            processes: []

  @type t :: %__MODULE__{
          pipeline: String.t(),
          state: :building | :starting | :running | :stopping | :completed,
          time: Situ.Time.t(),
          start_time: Situ.Time.t(),
          progress: float(),
          scopes: [String.t()],
          nodes: [Situ.Diagnostics.Node.t()],
          edges: [Situ.Diagnostics.Edge.t()],
          processes: [Situ.Diagnostics.Process.t()]
        }
end
