defmodule Situ.Pipeline.Report do
  @moduledoc """
  The result of `Situ.Pipeline.run/2` and `Situ.Pipeline.stop/2`.

    * `result`: the return value of `build`
    * `start_time`, `final_time`: pipeline clock, ns
    * `duration`: wall time from start to end, ns
    * `errors`: every `Situ.Error`, oldest first
    * `skipped`: the number of messages lost to `on_error: :skip | :restart`, by component path
    * `closed`: component paths in the order in which they closed
    * `snapshot`: the last `Situ.Diagnostics.Snapshot`, with messages, drops and latency of every edge
  """
  # A snapshot fills a page, so `inspect` leaves it out.
  @derive {Inspect, except: [:snapshot]}
  defstruct [
    :name,
    :result,
    :start_time,
    :final_time,
    :snapshot,
    duration: 0,
    errors: [],
    skipped: %{},
    closed: []
  ]

  @type t :: %__MODULE__{
          name: String.t(),
          result: term(),
          start_time: Situ.Time.t() | nil,
          final_time: Situ.Time.t() | nil,
          snapshot: Situ.Diagnostics.Snapshot.t() | nil,
          duration: Situ.Time.duration(),
          errors: [Situ.Error.t()],
          skipped: %{String.t() => non_neg_integer()},
          closed: [String.t()]
        }
end
