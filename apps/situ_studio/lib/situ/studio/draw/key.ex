defmodule Situ.Studio.Draw.Key do
  @moduledoc """
  Keys of maps as names on the page: what tells the lanes or lines of one stream apart.

      iex> Situ.Studio.Draw.Key.sort([:b, 10, 9, "a"]) |> Enum.map(&Situ.Studio.Draw.Key.text/1)
      ["9", "10", "a", "b"]
  """
  alias Situ.Studio.NaturalOrder

  @max_text 60
  @limit 32

  @doc "How many of one stream are drawn at most; of more, the first."
  @spec limit() :: pos_integer()
  def limit, do: @limit

  @doc "The name of a key, whatever term it is."
  @spec text(term()) :: String.t()
  def text(key) when is_binary(key) do
    if String.valid?(key), do: String.slice(key, 0, @max_text), else: cut(key)
  end

  def text(key) when is_atom(key) or is_number(key), do: to_string(key)
  def text(key), do: cut(key)

  defp cut(key),
    do: key |> inspect(limit: 8, printable_limit: @max_text) |> String.slice(0, @max_text)

  @doc "Numbers by size, then the others by name; at most `limit/0` of them."
  @spec sort([term()]) :: [term()]
  def sort(keys) do
    keys
    |> Enum.sort_by(&if is_number(&1), do: {0, &1}, else: {1, NaturalOrder.key(text(&1))})
    |> Enum.take(@limit)
  end
end
