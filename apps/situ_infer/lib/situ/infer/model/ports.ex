defmodule Situ.Infer.Model.Ports do
  @moduledoc false
  # The inputs and outputs that a model has, beside those that it should have. Pure.
  alias Situ.Error

  @type ports :: %{String.t() => {atom(), tuple()}}

  @doc "No text, sequences or maps, as networks of classical learning take them."
  @spec numbers(ports(), Path.t()) :: :ok | {:error, Error.t()}
  def numbers(inputs, path) do
    case for {name, {:unsupported, _}} <- inputs, do: inspect(name) do
      [] ->
        :ok

      names ->
        {:error,
         Error.new(
           :bad_model,
           "input #{Enum.join(names, ", ")} of the model takes no tensor of numbers (#{path})",
           why: "text, sequences and maps are not supported",
           fix: "export the model without them (skl2onnx: zipmap=False, numeric inputs)"
         )}
    end
  end

  @doc "Whether a model has what is wanted; `what` is \"input\" or \"output\"."
  @spec check(ports(), map(), String.t(), Path.t()) :: :ok | {:error, Error.t()}
  def check(has, wanted, what, path) do
    Enum.find_value(wanted, :ok, fn {name, {type, shape}} ->
      case has do
        %{^name => {^type, have}} ->
          if fits?(have, shape),
            do: nil,
            else: mismatch(what, name, {type, have}, {type, shape}, path)

        %{^name => have} ->
          mismatch(what, name, have, {type, shape}, path)

        _ ->
          {:error,
           Error.new(:model_shape, "the model has no #{what} #{inspect(name)} (#{path})",
             why: "its #{what}s are " <> Enum.map_join(has, ", ", &inspect(elem(&1, 0))),
             fix: "use the model file this component is made for"
           )}
      end
    end)
  end

  defp mismatch(what, name, have, wanted, path) do
    {:error,
     Error.new(
       :model_shape,
       "#{what} #{inspect(name)} is #{show(have)}, wanted #{show(wanted)} (#{path})",
       fix: "use the model file this component is made for"
     )}
  end

  @doc "A type and shape, for people."
  @spec show({atom(), tuple()}) :: String.t()
  def show({type, shape}), do: "#{type} #{inspect(shape)}"

  @doc "Whether a shape is what is wanted: a free dimension is -1 in the file and nil in what is asked for."
  @spec fits?(tuple(), tuple()) :: boolean()
  def fits?(have, wanted) do
    tuple_size(have) == tuple_size(wanted) and
      Enum.zip(Tuple.to_list(have), Tuple.to_list(wanted))
      |> Enum.all?(fn {h, w} -> h == -1 or w == nil or h == w end)
  end
end
