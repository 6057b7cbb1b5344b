defmodule Situ.Infer.Labels do
  @moduledoc false
  # Loads the names of a network's classes, and finds the output with their scores.
  alias Situ.Error
  alias Situ.Infer.Model

  @doc "Returns the names, from a list or a text file with one name per line."
  @spec load_names(Path.t() | [String.t()]) :: {:ok, tuple()} | {:error, Error.t()}
  def load_names(names) when is_list(names), do: {:ok, List.to_tuple(names)}

  def load_names(path) do
    with {:ok, text} <- File.read(path), true <- String.valid?(text) do
      {:ok, text |> String.trim_trailing() |> String.split(~r/\r?\n/) |> List.to_tuple()}
    else
      false ->
        {:error,
         Error.new(:bad_labels, "the file of class names is not UTF-8 text: #{path}",
           fix: "use a text file with one name per line"
         )}

      {:error, why} ->
        {:error,
         Error.new(:no_labels, "cannot read the file of class names: #{:file.format_error(why)}",
           fix: "check the path #{path}"
         )}
    end
  end

  @doc "Returns the name of the class with this number, or the number if it has no name."
  @spec class_name(tuple(), non_neg_integer()) :: String.t()
  def class_name(labels, index) when index < tuple_size(labels), do: elem(labels, index)
  def class_name(_labels, index), do: Integer.to_string(index)

  @doc "Returns the requested output, or the only one."
  @spec choose_output(Model.t(), String.t() | nil) :: {:ok, String.t()} | {:error, Error.t()}
  def choose_output(%Model{} = model, wanted) do
    names = Map.keys(model.outputs)

    case {wanted, names} do
      {nil, [name]} ->
        {:ok, name}

      {name, _} when is_binary(name) and is_map_key(model.outputs, name) ->
        {:ok, name}

      _ ->
        {:error,
         Error.new(:unknown_output, "cannot determine the output of model #{model.name}",
           why: "it has #{Enum.map_join(names, ", ", &inspect/1)}",
           fix: "choose an output with output:"
         )}
    end
  end
end
