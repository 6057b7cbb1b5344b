defmodule Situ.Experiment.Input do
  @moduledoc false
  # The session that `build/3` of an experiment reads, and the context of its run. Trials of a session share its open
  # recordings, because opening a video takes longer than a set of parameters whose stages are cached.
  alias Situ.Dataset.{Importer, OpenSession, Session}
  alias Situ.Experiment.Context

  @enforce_keys [:pipeline, :session, :context, :stamp]
  defstruct [:pipeline, :session, :context, :stamp, :opened]

  @typedoc """
  `stamp` identifies the contents of the session's recordings. `opened` is `nil` if they are opened when a stream is
  requested.
  """
  @type t :: %__MODULE__{
          pipeline: Situ.Pipeline.t(),
          session: Session.t(),
          context: Context.t(),
          stamp: String.t(),
          opened: OpenSession.t() | nil
        }

  @doc "Returns a stream of the session."
  @spec open_stream(t(), String.t(), keyword()) :: Situ.Stream.t()
  def open_stream(%__MODULE__{} = input, name, opts),
    do:
      input.pipeline
      |> Importer.open(input.opened || input.session)
      |> Importer.stream(name, opts)

  @doc "Returns whether a name refers to exactly one stream of the session."
  @spec has_stream?(t(), String.t()) :: boolean()
  def has_stream?(%__MODULE__{} = input, name),
    do: OpenSession.has_stream?(input.opened || OpenSession.open(input.session), name)
end
