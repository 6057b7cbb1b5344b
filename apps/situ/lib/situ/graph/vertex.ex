defmodule Situ.Graph.Vertex do
  @moduledoc false
  # A component of a graph. `module` is `:operator` for light operators, whose step is in `opts`.
  #
  # Ports are keyword lists. Inputs are `%{type, optional}`, outputs are `%{type, optional, source_id}`.
  # With `holds: false`, messages are not held back until the clock of their pipeline reaches them. `named?` is
  # true if the name was given, and false if it is derived from the module or operator.

  @enforce_keys [:id, :module]
  defstruct [
    :id,
    :module,
    :path,
    :policy,
    :scope,
    :unit,
    opts: [],
    inputs: [],
    outputs: [],
    on_error: :stop,
    async: false,
    check: :first,
    on_same_time: :error,
    holds: true,
    named?: false
  ]

  @type t :: %__MODULE__{
          id: pos_integer(),
          module: module() | :operator,
          path: String.t(),
          policy: Situ.Delivery.t() | nil,
          scope: String.t() | nil,
          unit: {String.t(), :restart | :close} | nil,
          opts: keyword() | Situ.Operator.step(),
          inputs: keyword(),
          outputs: keyword(),
          on_error: :stop | :skip | :restart,
          async: boolean(),
          check: :first | :all | :off,
          on_same_time: :error | :drop | :nudge,
          holds: boolean(),
          named?: boolean()
        }

  @doc "Returns whether the component is a source: it has no inputs, or it is a pull source."
  @spec source?(t()) :: boolean()
  def source?(%__MODULE__{module: :operator}), do: false
  def source?(%__MODULE__{inputs: []}), do: true
  def source?(%__MODULE__{module: module}), do: function_exported?(module, :handle_demand, 3)

  @doc "Returns whether the component may share its process; see `c:Situ.Component.share_process?/0`."
  @spec shares_process?(t()) :: boolean()
  def shares_process?(%__MODULE__{module: module}),
    do: function_exported?(module, :share_process?, 0) and module.share_process?()

  @doc "Returns whether it is a push source, which cannot wait because it does not emit on demand."
  @spec push_source?(t()) :: boolean()
  def push_source?(%__MODULE__{inputs: [], module: module}),
    do: module != :operator and not function_exported?(module, :handle_demand, 3)

  def push_source?(%__MODULE__{}), do: false
end
