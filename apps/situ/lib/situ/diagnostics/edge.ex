defmodule Situ.Diagnostics.Edge do
  @moduledoc false
  # One connection of a pipeline. `Situ.Diagnostics.Snapshot` documents the fields.
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
