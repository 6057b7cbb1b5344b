defmodule Situ.Diagnostics.Snapshot do
  @moduledoc """
  A pipeline at one moment: its graph with every statistic. It contains only plain structs, lists, numbers and
  strings, no pids, references or functions, so that it can be stored, sent and drawn.

    * `pipeline`: name; `state`: `:building | :starting | :running | :stopping | :completed`
    * `time`: pipeline clock, ns; `start_time`; `progress`: 0.0 to 1.0
    * `scopes`: paths of the composites, outer composites first (`["Mouth", "Mouth.Crop"]`); each is drawn as a box
    * `nodes`: `Situ.Diagnostics.Node`; `edges`: `Situ.Diagnostics.Edge`, joined by node ids
    * `processes`: `Situ.Diagnostics.Process`; nodes that share a process (chained operators) have the same process
      number
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

    * `id`, `path` (`"Mouth.Crop"`), `scope` (`"Mouth"` or `nil`), `module` (its name as a string, `"Operator"` for
      light operators)
    * `kind`: `:source | :component | :operator | :tap`; `state`: `:running | :closed | :failed`
    * `process`: number of the process that runs it, or `nil` before the start
    * `inputs`, `outputs`: lists of `%{name, type, stream}`, all strings; `stream` is the stream's name (outputs only)
    * `errors`, `restarts`, `skipped`: counts; `description`: the last result of the component's `describe/1`, or
      `nil`
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

defmodule Situ.Diagnostics.Window do
  @moduledoc """
  The traffic of a connection in the last averaging span (`averaging:` among the pipeline's settings, default 1 s).

    * `span`: the actual length of the window, ns of the pipeline's clock: up to half a span more than requested, and
      less just after the start
    * `emitted`, `processed`, `dropped`: counts
    * `created`, `posted`, `latency`: mean ages of messages when they were created, queued and taken by the consumer,
      ns
    * `handling`: mean time in the consumer, ns; `queue`: mean length left when a message was taken; `size`: mean
      bytes

  A mean without any messages is `nil`.

      iex> window = %Situ.Diagnostics.Window{span: 2_000_000_000, emitted: 50, processed: 30, dropped: 10}
      iex> {Situ.Diagnostics.rate(window.processed, window), Situ.Diagnostics.percent(window.dropped, window.emitted)}
      {15.0, 20.0}
  """
  defstruct span: 0,
            emitted: 0,
            processed: 0,
            dropped: 0,
            created: nil,
            posted: nil,
            latency: nil,
            handling: nil,
            queue: nil,
            size: nil

  @type t :: %__MODULE__{
          span: Situ.Time.duration(),
          emitted: non_neg_integer(),
          processed: non_neg_integer(),
          dropped: non_neg_integer(),
          created: Situ.Time.duration() | nil,
          posted: Situ.Time.duration() | nil,
          latency: Situ.Time.duration() | nil,
          handling: Situ.Time.duration() | nil,
          queue: float() | nil,
          size: non_neg_integer() | nil
        }

  @doc "Returns `part` as a percentage of `whole`, or 0.0 if `whole` is not positive."
  @spec percent(number(), number()) :: float()
  def percent(_part, whole) when whole <= 0, do: 0.0
  def percent(part, whole), do: part * 100 / whole

  @doc "Converts a count of the window to a rate per second."
  @spec rate(number(), t()) :: float()
  def rate(_n, %__MODULE__{span: 0}), do: 0.0
  def rate(n, %__MODULE__{span: span}), do: n * 1.0e9 / span
end

defmodule Situ.Diagnostics.Edge do
  @moduledoc """
  One connection in a `Situ.Diagnostics.Snapshot`. Counts are totals since the start, times are ns.

    * `from`, `from_output`, `to`, `to_input`: node ids and port names (strings); `policy`: its name
    * `kind`: `:process` (a queue between two processes) or `:inline` (inside one process, without a queue; the counts
      of the chain's entry)
    * `emitted`: messages added to the queue; `processed`: messages taken by the consumer; `dropped`: messages dropped
      by the policy; `queue`: messages waiting now (emitted - processed - dropped); `queue_mean`: mean number left
      waiting when a message was taken; `throttled`: whether the producer is waiting for this edge
    * `created_last`, `created_mean`: creation time - originating time; `posted_last`, `posted_mean`: clock when the
      message was queued - originating time (more than the creation delay if an importer or a connector keeps creation
      times); `latency_last`, `latency_mean`, `latency_p99`: clock when the consumer took the message - originating
      time; p99 is the upper bound of its histogram bucket (within 25 %)
    * `handling_last`, `handling_mean`: time spent in the consumer per message; `busy`: their sum
    * `size_last`, `size_mean`: bytes of the data, with the pipeline setting `message_sizes: true`; otherwise 0
    * `window`: the same means and counts over the last averaging span, a `Situ.Diagnostics.Window`

  Means are per message. Under load, messages travel in batches, and the last message of a batch is measured for all.
  """
  alias Situ.Diagnostics.Window

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
    queue_mean: 0.0,
    throttled: false,
    created_last: 0,
    created_mean: 0,
    posted_last: 0,
    posted_mean: 0,
    latency_last: 0,
    latency_mean: 0,
    latency_p99: 0,
    handling_last: 0,
    handling_mean: 0,
    busy: 0,
    size_last: 0,
    size_mean: 0,
    window: %Window{}
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
          queue_mean: float(),
          throttled: boolean(),
          created_last: Situ.Time.duration(),
          created_mean: Situ.Time.duration(),
          posted_last: Situ.Time.duration(),
          posted_mean: Situ.Time.duration(),
          latency_last: Situ.Time.duration(),
          latency_mean: Situ.Time.duration(),
          latency_p99: Situ.Time.duration(),
          handling_last: Situ.Time.duration(),
          handling_mean: Situ.Time.duration(),
          busy: Situ.Time.duration(),
          size_last: non_neg_integer(),
          size_mean: non_neg_integer(),
          window: Window.t()
        }
end

defmodule Situ.Diagnostics.Process do
  @moduledoc """
  One process of a pipeline in a `Situ.Diagnostics.Snapshot`: `number`, `pid` (a string, `""` once it has ended),
  `nodes` (paths of its nodes, in order), `memory` (bytes), `mailbox` (messages waiting), `reductions` (total),
  `status` (`"waiting"`, `"running"` ...), `busy_in` (the function that it is executing, as a string; shows where a
  component is stuck).
  """
  defstruct number: 0,
            pid: "",
            nodes: [],
            memory: 0,
            mailbox: 0,
            reductions: 0,
            status: "",
            busy_in: ""

  @type t :: %__MODULE__{
          number: pos_integer(),
          pid: String.t(),
          nodes: [String.t()],
          memory: non_neg_integer(),
          mailbox: non_neg_integer(),
          reductions: non_neg_integer(),
          status: String.t(),
          busy_in: String.t()
        }
end
