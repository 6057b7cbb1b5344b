defmodule Situ.Store.TypeName do
  @moduledoc false
  # Converts types to strings for a store's catalog, and back without creating atoms or running
  # code.
  alias Situ.KnownModules

  @doc """
  Formats a type.

      iex> Situ.Store.TypeName.format_type({:list, :float})
      "{:list, :float}"
  """
  @spec format_type(Situ.Type.t()) :: String.t()
  def format_type(type), do: inspect(type, limit: :infinity)

  @doc """
  Parses a type without running code or creating atoms.

      iex> Situ.Store.TypeName.parse_type("{:list, :float}")
      {:ok, {:list, :float}}
      iex> Situ.Store.TypeName.parse_type("Never.Heard.Of")
      :error
      iex> Situ.Store.TypeName.parse_type("File.rm_rf!(:x)")
      :error
  """
  @spec parse_type(String.t()) :: {:ok, Situ.Type.t()} | :error
  def parse_type(text) when is_binary(text) and byte_size(text) < 10_000 do
    # Names stay strings during parsing, because the parts of an alias may not exist as atoms even if the module does.
    opts = [static_atoms_encoder: fn name, _ -> {:ok, {:"$name", name}} end, emit_warnings: false]

    # Loading this module creates the atoms of the type names.
    {:module, _} = Code.ensure_loaded(Situ.Type)

    with true <- String.valid?(text),
         {:ok, quoted} <- Code.string_to_quoted(text, opts),
         {:ok, type} <- parse_literal(quoted) do
      {:ok, type}
    else
      _ -> :error
    end
  rescue
    # The tokenizer expects some keys of keyword lists to be atoms, which they are not here.
    _ in [ArgumentError, FunctionClauseError] -> :error
  end

  def parse_type(_), do: :error

  # A module is written as an alias (`:"Elixir.My.Pose"` is another notation for it).
  defp parse_literal({:"$name", "Elixir." <> _ = name}), do: KnownModules.fetch_module(name)
  defp parse_literal({:"$name", name}), do: existing_atom(name)

  defp parse_literal(value) when is_atom(value) or is_number(value) or is_binary(value),
    do: {:ok, value}

  defp parse_literal({:__aliases__, _, parts}) do
    if Enum.all?(parts, &match?({:"$name", _}, &1)),
      do: KnownModules.fetch_module("Elixir." <> Enum.map_join(parts, ".", &elem(&1, 1))),
      else: :error
  end

  defp parse_literal({:{}, _, elements}), do: parse_tuple(elements)
  defp parse_literal({:-, _, [number]}) when is_number(number), do: {:ok, -number}
  defp parse_literal({a, b}), do: parse_tuple([a, b])
  defp parse_literal(list) when is_list(list), do: parse_all(list)
  defp parse_literal(_), do: :error

  defp existing_atom(name) do
    {:ok, String.to_existing_atom(name)}
  rescue
    ArgumentError -> :error
  end

  defp parse_tuple(elements) do
    with {:ok, values} <- parse_all(elements), do: {:ok, List.to_tuple(values)}
  end

  defp parse_all(elements) do
    Enum.reduce_while(Enum.reverse(elements), {:ok, []}, fn element, {:ok, values} ->
      case parse_literal(element) do
        {:ok, value} -> {:cont, {:ok, [value | values]}}
        :error -> {:halt, :error}
      end
    end)
  end
end
