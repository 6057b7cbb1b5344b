defmodule Situ.Python.ClassList do
  @moduledoc false
  # Lists the components of a Python file: Python loads it and prints a description (`situ.worker.describe`).
  alias Situ.{Error, Options}
  alias Situ.Python.{Environment, Program}

  @schema [
    python: [type: :string, default: "python3"],
    requirements: [type: {:optional, {:or, [:string, {:list, :string}]}}, default: nil]
  ]

  @spec list_classes(Path.t(), keyword()) :: {:ok, [map()]} | {:error, Error.t()}
  def list_classes(path, opts) do
    opts = Options.validate!(opts, @schema)

    with :ok <- Program.check_source(path),
         {:ok, interpreter} <- Program.find_interpreter(opts[:python]),
         {:ok, interpreter} <- find_environment(interpreter, path, opts[:requirements]) do
      interpreter |> Program.call_function("describe", [path]) |> decode(path)
    end
  end

  defp find_environment(interpreter, _path, nil), do: {:ok, interpreter}

  defp find_environment(interpreter, path, requirements),
    do: Environment.find_or_create(requirements, interpreter, Environment.default_config(path))

  # The program may print something while it is loaded.
  defp decode({:ok, output}, path) do
    with line when is_binary(line) <- output |> String.split("\n", trim: true) |> List.last(),
         {:ok, classes} when is_list(classes) <- Situ.JSON.decode(line) do
      {:ok, classes}
    else
      _ -> {:error, failed_error(path, output)}
    end
  end

  defp decode({:error, output}, path), do: {:error, failed_error(path, output)}

  defp failed_error(path, output),
    do: Error.new(:python_failed, "#{path} cannot be loaded", why: output)
end
