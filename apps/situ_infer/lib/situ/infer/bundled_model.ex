defmodule Situ.Infer.BundledModel do
  @moduledoc false
  # Loads the networks that are part of this app, for components whose users may replace them by another file.
  alias Situ.Error
  alias Situ.Infer.Model

  @doc "Returns the schema of the options of `load/3`, for components that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema do
    [
      model: [
        type: {:optional, :string},
        default: nil,
        doc: "The ONNX file; `nil` uses the bundled one."
      ],
      model_options: [
        type: :keyword,
        default: [],
        doc: "Options for `Situ.Infer.Model.load_shared/2`."
      ]
    ]
  end

  @doc """
  Loads and shares the model `opts[:model]`, or the bundled file `file`. `opts[:model_options]` are its options, to
  which `settings` are added.
  """
  @spec load(keyword(), String.t(), keyword()) :: {:ok, Model.t()} | {:error, Error.t()}
  def load(opts, file, settings) do
    path = opts[:model] || Model.bundled_path(file)
    Model.load_shared(path, Keyword.merge(opts[:model_options] || [], settings))
  end
end
