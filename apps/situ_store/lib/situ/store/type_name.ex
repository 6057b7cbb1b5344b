defmodule Situ.Store.TypeName do
  @moduledoc """
  Converts types to strings for a store's catalog, and back without creating atoms or running code.

      iex> Situ.Store.TypeName.write({:list, :float})
      "{:list, :float}"
      iex> Situ.Store.TypeName.read("{:list, :float}")
      {:ok, {:list, :float}}
      iex> Situ.Store.TypeName.read("Never.Heard.Of")
      :error
      iex> Situ.Store.TypeName.read("File.rm_rf!(:x)")
      :error
  """
  alias Situ.KnownModules

  @spec write(Situ.Type.t()) :: String.t()
  def write(type), do: inspect(type, limit: :infinity)

  @spec read(String.t()) :: {:ok, Situ.Type.t()} | :error
  def read(text) when is_binary(text) and byte_size(text) < 10_000 do
    # Names stay strings during parsing, because the parts of an alias may not exist as atoms even if the module does.
    opts = [static_atoms_encoder: fn name, _ -> {:ok, {:"$name", name}} end, emit_warnings: false]

    # Loading this module creates the atoms of the type names.
    {:module, _} = Code.ensure_loaded(Situ.Type)

    with true <- String.valid?(text),
         {:ok, quoted} <- Code.string_to_quoted(text, opts),
         {:ok, type} <- literal(quoted) do
      {:ok, type}
    else
      _ -> :error
    end
  rescue
    # The tokenizer expects some keys of keyword lists to be atoms, which they are not here.
    _ in [ArgumentError, FunctionClauseError] -> :error
  end

  def read(_), do: :error

  # A module is written as an alias (`:"Elixir.My.Pose"` is another notation for it).
  defp literal({:"$name", "Elixir." <> _ = name}), do: KnownModules.fetch(name)
  defp literal({:"$name", name}), do: existing(name)

  defp literal(value) when is_atom(value) or is_number(value) or is_binary(value),
    do: {:ok, value}

  defp literal({:__aliases__, _, parts}) do
    if Enum.all?(parts, &match?({:"$name", _}, &1)),
      do: KnownModules.fetch("Elixir." <> Enum.map_join(parts, ".", &elem(&1, 1))),
      else: :error
  end

  defp literal({:{}, _, elements}), do: tuple(elements)
  defp literal({:-, _, [number]}) when is_number(number), do: {:ok, -number}
  defp literal({a, b}), do: tuple([a, b])
  defp literal(list) when is_list(list), do: all(list)
  defp literal(_), do: :error

  defp existing(name) do
    {:ok, String.to_existing_atom(name)}
  rescue
    ArgumentError -> :error
  end

  defp tuple(elements) do
    with {:ok, values} <- all(elements), do: {:ok, List.to_tuple(values)}
  end

  defp all(elements) do
    Enum.reduce_while(Enum.reverse(elements), {:ok, []}, fn element, {:ok, values} ->
      case literal(element) do
        {:ok, value} -> {:cont, {:ok, [value | values]}}
        :error -> {:halt, :error}
      end
    end)
  end
end
