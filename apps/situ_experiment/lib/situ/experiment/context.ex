defmodule Situ.Experiment.Context do
  @moduledoc false
  # The common parts of all results of a run: the experiment, its folder and the code that it consists of.
  alias Situ.Experiment.CodeVersion

  @enforce_keys [:module, :folder, :code]
  defstruct [:module, :folder, :code, :owner]

  @type t :: %__MODULE__{
          module: module(),
          folder: Path.t(),
          code: CodeVersion.t(),
          owner: pid() | nil
        }

  @doc "Returns the speed of the replay."
  @spec speed(t()) :: :max | number()
  def speed(%__MODULE__{module: module}), do: Keyword.get(module.settings(), :speed, :max)

  @doc "Returns the settings of the pipelines."
  @spec pipeline_settings(t()) :: keyword()
  def pipeline_settings(context), do: [replay: [speed: speed(context)]]
end
