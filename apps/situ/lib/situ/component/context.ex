defmodule Situ.Component.Context do
  @moduledoc """
  A component's view of its pipeline: its path, the clock and the replay interval.

    * `path`: the component's full name (`"Lobby.Mouth.Crop"`)
    * `pipeline`: the pipeline's handle
    * `now`: the pipeline clock when this activation began, ns
    * `start_time`: the pipeline's start, ns (the replay start, or the clock when the pipeline began); for a component
      that was added to a running pipeline, the pipeline clock at that moment
    * `replay_start`: the start of the replay interval, requested or proposed, ns; or `:unbounded` if the pipeline
      starts at the current time
    * `replay_end`: the end of the replay interval, ns, or `:infinity`
    * `enforced?`: whether messages wait for their time on the clock (false at speed `:max`)
  """
  defstruct [
    :path,
    :pipeline,
    now: 0,
    start_time: 0,
    replay_start: :unbounded,
    replay_end: :infinity,
    enforced?: true
  ]

  @type t :: %__MODULE__{
          path: String.t() | nil,
          pipeline: term(),
          now: Situ.Time.t(),
          start_time: Situ.Time.t(),
          replay_start: Situ.Time.t() | :unbounded,
          replay_end: Situ.Time.t() | :infinity,
          enforced?: boolean()
        }
end
