defmodule Situ.Diagnostics.Snapshot do
  @moduledoc """
  A pipeline at one moment: its graph with every statistic. It contains only plain structs, lists, numbers and
  strings, no pids, references or functions, so that it can be stored, sent and drawn.

    * `pipeline`: name; `state`: `:building | :starting | :running | :stopping | :completed`
    * `time`: pipeline clock, ns; `start_time`; `progress`: 0.0 to 1.0
    * `scopes`: paths of the composites, outer composites first (`["Mouth", "Mouth.Crop"]`); each is drawn as a box
    * `nodes`, `edges`, `processes`: lists of structs with the fields below; edges refer to nodes by their ids

      iex> {:ok, report} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.from_enumerable(1..3, every: 1, name: "Numbers") |> Situ.each(& &1, name: "Sink")
      ...> end)
      iex> for node <- report.snapshot.nodes, do: {node.path, node.kind, node.errors}
      [{"Numbers", :source, 0}, {"Sink", :operator, 0}]

  ## Components (`nodes`)

    * `id`, `path` (`"Mouth.Crop"`), `scope` (`"Mouth"` or `nil`), `module` (its name as a string, `"Operator"` for
      light operators)
    * `kind`: `:source | :component | :operator | :tap`; `state`: `:running | :closed | :failed`
    * `process`: number of the process that runs it, or `nil` before the start
    * `inputs`, `outputs`: lists of `%{name, type, stream}`, all strings; `stream` is the stream's name (outputs only)
    * `errors`, `restarts`, `skipped`: counts; `description`: the last result of the component's `describe/1`, or `nil`

  ## Connections (`edges`)

  Counts are totals since the start, and times are ns. Means are per message. Under load, messages travel in batches,
  and the last message of a batch is measured for all.

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
    * `window`: the traffic of the last averaging span (`averaging:` among the pipeline's settings, default 1 s), with
      the actual length of the window, `span`, in ns of the pipeline's clock: up to half a span more than requested, and
      less just after the start; the counts `emitted`, `processed`, `dropped`; and the means `created`, `posted`,
      `latency`, `handling`, `queue`, `size`, each `nil` if there were no messages

  ## Processes

    * `number`, `pid` (a string, `""` once it has ended), `nodes` (paths of its nodes, in order). Nodes that share a
      process (chained operators) have the same process number
    * `memory` (bytes), `mailbox` (messages waiting), `reductions` (total), `status` (`"waiting"`, `"running"` ...)
    * `busy_in`: the function that it is executing, as a string; shows where a component is stuck
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

  # A snapshot fills a page. `Situ.inspect/2` prints a table of it.
  defimpl Inspect do
    def inspect(snapshot, _opts) do
      running = Situ.Time.format_duration(max(snapshot.time - snapshot.start_time, 0))
      parts = "#{length(snapshot.nodes)} components, #{length(snapshot.edges)} connections"

      "#Situ.Diagnostics.Snapshot<#{Kernel.inspect(snapshot.pipeline)}, #{snapshot.state}, " <>
        "#{parts}, after #{running}>"
    end
  end
end
