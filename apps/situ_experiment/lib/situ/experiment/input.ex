defmodule Situ.Experiment.Input do
  @moduledoc false
  # The session that `build/3` of an experiment reads, and the context of its run.
  alias Situ.Dataset.{Importer, Session}
  alias Situ.Experiment.Context

  @enforce_keys [:importer, :context, :stamp]
  defstruct [:importer, :context, :stamp]

  @type t :: %__MODULE__{importer: Importer.t(), context: Context.t(), stamp: String.t()}

  @doc "Opens a session in a pipeline. `stamp` identifies the contents of its recordings."
  @spec open(Situ.Pipeline.t(), Session.t(), Context.t(), String.t()) :: t()
  def open(p, %Session{} = session, %Context{} = context, stamp) do
    importer = Importer.open(p, session)

    case importer.session do
      %{stores: [], troubles: [{_, error} | _]} -> raise error
      _ -> %__MODULE__{importer: importer, context: context, stamp: stamp}
    end
  end
end
