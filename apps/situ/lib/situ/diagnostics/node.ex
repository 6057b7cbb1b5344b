defmodule Situ.Diagnostics.Node do
  @moduledoc false
  # One component in a `Situ.Diagnostics.Snapshot`.
  #
  #   * `id`, `path` (`"Mouth.Crop"`), `scope` (`"Mouth"` or `nil`), `module` (its name as a string, `"Operator"` for
  #     light operators)
  #   * `kind`: `:source | :component | :operator | :tap`; `state`: `:running | :closed | :failed`
  #   * `process`: number of the process that runs it, or `nil` before the start
  #   * `inputs`, `outputs`: lists of `%{name, type, stream}`, all strings; `stream` is the stream's name (outputs only)
  #   * `errors`, `restarts`, `skipped`: counts; `description`: the last result of the component's `describe/1`, or
  #     `nil`
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
