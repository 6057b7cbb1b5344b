defmodule Situ.Infer.Model.PortCheck do
  @moduledoc false
  # Compares the inputs and outputs of a model with the expected ones. Pure.
  alias Situ.Error

  @type ports :: %{String.t() => {atom(), tuple()}}

  @doc "Checks that no input takes text, sequences or maps, as models of classical machine learning do."
  @spec check_numeric(ports(), Path.t()) :: :ok | {:error, Error.t()}
  def check_numeric(inputs, path) do
    case for {name, {:unsupported, _}} <- inputs, do: inspect(name) do
      [] ->
        :ok

      names ->
        {:error,
         Error.new(
           :bad_model,
           "input #{Enum.join(names, ", ")} of the model does not take a tensor of numbers (#{path})",
           why: "inputs of text, sequences and maps are not supported",
           fix: "export the model without them (skl2onnx: zipmap=False, numeric inputs)"
         )}
    end
  end

  @doc "Checks that a model has the expected ports; `what` is \"input\" or \"output\"."
  @spec check_ports(ports(), map(), String.t(), Path.t()) :: :ok | {:error, Error.t()}
  def check_ports(ports, expected, what, path) do
    Enum.find_value(expected, :ok, fn {name, {type, shape}} ->
      case ports do
        %{^name => {^type, actual}} ->
          if shape_matches?(actual, shape),
            do: nil,
            else: port_mismatch(what, name, {type, actual}, {type, shape}, path)

        %{^name => actual} ->
          port_mismatch(what, name, actual, {type, shape}, path)

        _ ->
          {:error,
           Error.new(:model_shape, "the model has no #{what} #{inspect(name)} (#{path})",
             why: "its #{what}s are " <> Enum.map_join(ports, ", ", &inspect(elem(&1, 0))),
             fix: "use the model file this component is made for"
           )}
      end
    end)
  end

  defp port_mismatch(what, name, actual, expected, path) do
    {:error,
     Error.new(
       :model_shape,
       "#{what} #{inspect(name)} is #{format_port(actual)}, expected #{format_port(expected)} (#{path})",
       fix: "use the model file this component is made for"
     )}
  end

  @doc "Formats a type and shape for people."
  @spec format_port({atom(), tuple()}) :: String.t()
  def format_port({type, shape}), do: "#{type} #{inspect(shape)}"

  @doc "Returns whether a shape matches the expected one. A free dimension is -1 in the file, and nil in `expected`."
  @spec shape_matches?(tuple(), tuple()) :: boolean()
  def shape_matches?(actual, expected) do
    tuple_size(actual) == tuple_size(expected) and
      Enum.zip(Tuple.to_list(actual), Tuple.to_list(expected))
      |> Enum.all?(fn {h, w} -> h == -1 or w == nil or h == w end)
  end
end
