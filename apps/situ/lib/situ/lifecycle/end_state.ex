defmodule Situ.Lifecycle.EndState do
  @moduledoc false
  # When and how a pipeline ends.
  #
  #   wish     the requested end: `{time | :now, by_hand?}`; the pipeline begins to end as soon as it can
  #   final    the time up to which messages count
  #   by_hand  limits sources that lag behind the clock, and cycles that never settle, to `catch_up` ms
  #   enough?  whether these ms have passed
  #   drain    the last measurement of a cycle that has yet to settle: `{mark, polls}`
  #   latest   the latest end that a source has reported
  #   finite   the sources that have reported an end
  #   moves    how many movements occurred that the counters do not show
  defstruct [
    :wish,
    :final,
    :drain,
    :latest,
    finite: MapSet.new(),
    by_hand: false,
    enough?: false,
    catch_up: 1_000,
    moves: 0
  ]

  @type t :: %__MODULE__{
          wish: {Situ.Time.t() | :now, boolean()} | nil,
          final: Situ.Time.t() | nil,
          drain: {term(), non_neg_integer()} | nil,
          latest: Situ.Time.t() | nil,
          finite: MapSet.t(pos_integer()),
          by_hand: boolean(),
          enough?: boolean(),
          catch_up: non_neg_integer(),
          moves: non_neg_integer()
        }
end
