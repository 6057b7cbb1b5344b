defmodule Situ.Diagnostics.Snapshot do
  @moduledoc """
  A pipeline at one moment: its graph with every statistic, as plain structs, lists, numbers and strings, without any pid,
  reference or function, so that it can be stored, sent and drawn.

    * `pipeline`: name; `state`: `:building | :starting | :running | :stopping | :completed`
    * `time`: pipeline clock, ns; `start_time`; `progress`: 0.0 to 1.0
    * `scopes`: paths of the composites, outer ones first (`["Mouth", "Mouth.Crop"]`); each is drawn as a box
    * `nodes`: `Situ.Diagnostics.Node`; `edges`: `Situ.Diagnostics.Edge`, joined by node ids
    * `processes`: `Situ.Diagnostics.Process`; nodes that share one (chained operators) name the same process number
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

defmodule Situ.Diagnostics.Node do
  @moduledoc """
  One component in a `Situ.Diagnostics.Snapshot`.

    * `id`, `path` (`"Mouth.Crop"`), `scope` (`"Mouth"` or `nil`), `module` (its name as text, `"Operator"` for light ones)
    * `kind`: `:source | :component | :operator | :tap`; `state`: `:running | :closed | :failed`
    * `process`: number of the process it runs in, or `nil` before the start
    * `inputs`, `outputs`: lists of `%{name, type, stream}`, all text; `stream` is the stream's name (outputs only)
    * `errors`, `restarts`, `skipped`: counts; `description`: what the component's `describe/1` said last, or `nil`
  """
  defstruct [
    :id,
    :path,
    :scope,
    :module,
    :process,
    :description,
    kind: :component,
    state: :running,
    inputs: [],
    outputs: [],
    errors: 0,
    restarts: 0,
    skipped: 0
  ]

  @type port_info :: %{name: String.t(), type: String.t(), stream: String.t() | nil}
  @type t :: %__MODULE__{
          id: pos_integer(),
          path: String.t(),
          scope: String.t() | nil,
          module: String.t(),
          process: pos_integer() | nil,
          description: String.t() | nil,
          kind: :source | :component | :operator | :tap,
          state: :running | :closed | :failed,
          inputs: [port_info()],
          outputs: [port_info()],
          errors: non_neg_integer(),
          restarts: non_neg_integer(),
          skipped: non_neg_integer()
        }
end

defmodule Situ.Diagnostics.Edge do
  @moduledoc """
  One connection in a `Situ.Diagnostics.Snapshot`. Counts are totals since the start, times are ns.

    * `from`, `from_output`, `to`, `to_input`: node ids and port names (text); `policy`: its name
    * `kind`: `:process` (a queue between two processes) or `:inline` (inside one process: no queue; counts are those of
      the chain's entry)
    * `emitted`: handed to the queue; `processed`: taken by the consumer; `dropped`: by the policy; `queue`: waiting now
      (emitted - processed - dropped); `throttled`: the producer waits for this edge
    * `latency_last`, `latency_mean`, `latency_p99`: age (clock - originating time) when the consumer took it; p99 is the
      upper bound of its histogram bucket (within 25 %)
    * `busy`: total time spent in the consumer for this edge's messages; `busy / processed` is the mean handling time
  """
  defstruct [
    :id,
    :from,
    :from_output,
    :to,
    :to_input,
    :policy,
    kind: :process,
    emitted: 0,
    processed: 0,
    dropped: 0,
    queue: 0,
    throttled: false,
    latency_last: 0,
    latency_mean: 0,
    latency_p99: 0,
    busy: 0
  ]

  @type t :: %__MODULE__{
          id: pos_integer(),
          from: pos_integer(),
          from_output: String.t(),
          to: pos_integer(),
          to_input: String.t(),
          policy: String.t(),
          kind: :process | :inline,
          emitted: non_neg_integer(),
          processed: non_neg_integer(),
          dropped: non_neg_integer(),
          queue: non_neg_integer(),
          throttled: boolean(),
          latency_last: Situ.Time.duration(),
          latency_mean: Situ.Time.duration(),
          latency_p99: Situ.Time.duration(),
          busy: Situ.Time.duration()
        }
end

defmodule Situ.Diagnostics.Process do
  @moduledoc """
  One process of a pipeline in a `Situ.Diagnostics.Snapshot`: `number`, `nodes` (paths it hosts, in order), `memory` (bytes),
  `mailbox` (messages waiting), `reductions` (total), `status` (`"waiting"`, `"running"` ...), `busy_in` (the function it is
  in, as text: names what a stuck component is doing).
  """
  defstruct number: 0, nodes: [], memory: 0, mailbox: 0, reductions: 0, status: "", busy_in: ""

  @type t :: %__MODULE__{
          number: pos_integer(),
          nodes: [String.t()],
          memory: non_neg_integer(),
          mailbox: non_neg_integer(),
          reductions: non_neg_integer(),
          status: String.t(),
          busy_in: String.t()
        }
end
