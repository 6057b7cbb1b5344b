defmodule Situ.Diagnostics.Edge do
  @moduledoc false
  # One connection in a `Situ.Diagnostics.Snapshot`. Counts are totals since the start, times are
  # ns.
  #
  #   * `from`, `from_output`, `to`, `to_input`: node ids and port names (strings); `policy`: its name
  #   * `kind`: `:process` (a queue between two processes) or `:inline` (inside one process, without a queue; the counts
  #     of the chain's entry)
  #   * `emitted`: messages added to the queue; `processed`: messages taken by the consumer; `dropped`: messages dropped
  #     by the policy; `queue`: messages waiting now (emitted - processed - dropped); `queue_mean`: mean number left
  #     waiting when a message was taken; `throttled`: whether the producer is waiting for this edge
  #   * `created_last`, `created_mean`: creation time - originating time; `posted_last`, `posted_mean`: clock when the
  #     message was queued - originating time (more than the creation delay if an importer or a connector keeps creation
  #     times); `latency_last`, `latency_mean`, `latency_p99`: clock when the consumer took the message - originating
  #     time; p99 is the upper bound of its histogram bucket (within 25 %)
  #   * `handling_last`, `handling_mean`: time spent in the consumer per message; `busy`: their sum
  #   * `size_last`, `size_mean`: bytes of the data, with the pipeline setting `message_sizes: true`; otherwise 0
  #   * `window`: the traffic of the last averaging span (`averaging:` among the pipeline's settings, default 1 s), with
  #     the actual length of the window, `span`, in ns of the pipeline's clock: up to half a span
  #     more than requested, and
  #     less just after the start; the counts `emitted`, `processed`, `dropped`; and the means `created`, `posted`,
  #     `latency`, `handling`, `queue`, `size`, each `nil` if there were no messages
  #
  # Means are per message. Under load, messages travel in batches, and the last message of a batch
  # is measured for all.
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
