defmodule Situ.Store.TypeName do
  @moduledoc """
  Types as text in a store's catalog, and back without making atoms or running anything.

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
    # Names stay text while parsing: the parts of an alias need not be atoms in a system that has the whole.
    opts = [static_atoms_encoder: fn name, _ -> {:ok, {:"$name", name}} end, emit_warnings: false]

    # its loading is what makes the words of types known
    {:module, _} = Code.ensure_loaded(Situ.Type)

    with true <- String.valid?(text),
         {:ok, quoted} <- Code.string_to_quoted(text, opts),
         {:ok, type} <- literal(quoted) do
      {:ok, type}
    else
      _ -> :error
    end
  rescue
    # The tokenizer takes some keys of keyword lists for atoms, which here they are not.
    _ in [ArgumentError, FunctionClauseError] -> :error
  end

  def read(_), do: :error

  # A module is written as an alias (`:"Elixir.My.Pose"` is another spelling of it).
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
