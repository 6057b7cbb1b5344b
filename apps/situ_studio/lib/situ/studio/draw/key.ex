defmodule Situ.Studio.Draw.Key do
  @moduledoc """
  Names map keys on the page, to distinguish the lanes or lines of one stream.

      iex> Situ.Studio.Draw.Key.sort([:b, 10, 9, "a"]) |> Enum.map(&Situ.Studio.Draw.Key.text/1)
      ["9", "10", "a", "b"]
  """
  alias Situ.Studio.NaturalOrder

  @max_text 60
  @limit 32

  @doc "Returns the maximum number of keys drawn for one stream. Further keys are left out."
  @spec limit() :: pos_integer()
  def limit, do: @limit

  @doc "Returns the display name of a key, which may be any term."
  @spec text(term()) :: String.t()
  def text(key) when is_binary(key) do
    if String.valid?(key), do: String.slice(key, 0, @max_text), else: cut(key)
  end

  def text(key) when is_atom(key) or is_number(key), do: to_string(key)
  def text(key), do: cut(key)

  defp cut(key),
    do: key |> inspect(limit: 8, printable_limit: @max_text) |> String.slice(0, @max_text)

  @doc "Sorts numbers by size and the other keys after them by name. Returns at most `limit/0` keys."
  @spec sort([term()]) :: [term()]
  def sort(keys) do
    keys
    |> Enum.sort_by(&if is_number(&1), do: {0, &1}, else: {1, NaturalOrder.key(text(&1))})
    |> Enum.take(@limit)
  end
end
