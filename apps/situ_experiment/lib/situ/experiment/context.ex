defmodule Situ.Experiment.Context do
  @moduledoc false
  # The common parts of all results of a run: the experiment, its folder and the code that it consists of.
  alias Situ.Experiment.CodeVersion

  @enforce_keys [:module, :folder, :code]
  defstruct [:module, :folder, :code, :owner, :peer]

  @typedoc "On a node of a cluster: the node that started the run, and the folder of the results there."
  @type peer :: %{node: node(), folder: Path.t()}

  @type t :: %__MODULE__{
          module: module(),
          folder: Path.t(),
          code: CodeVersion.t(),
          owner: pid() | nil,
          peer: peer() | nil
        }

  @doc "Returns the speed of the replay."
  @spec speed(t()) :: :max | number()
  def speed(%__MODULE__{module: module}), do: Keyword.get(module.settings(), :speed, :max)

  @doc "Returns the settings of the pipelines."
  @spec pipeline_settings(t()) :: keyword()
  def pipeline_settings(context), do: [replay: [speed: speed(context)]]
end
