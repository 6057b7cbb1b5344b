defmodule Situ.Diagnostics.Node do
  @moduledoc false
  # One component of a pipeline. `Situ.Diagnostics.Snapshot` documents the fields.
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
