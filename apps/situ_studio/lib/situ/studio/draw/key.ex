defmodule Situ.Studio.Draw.Key do
  @moduledoc false
  # Names map keys on the page, to distinguish the lanes or lines of one stream.
  alias Situ.Studio.NaturalOrder

  @max_text 60
  @limit 32

  @doc "Returns the display name of a key, which may be any term."
  @spec key_name(term()) :: String.t()
  def key_name(key) when is_binary(key) do
    if String.valid?(key), do: String.slice(key, 0, @max_text), else: inspect_key(key)
  end

  def key_name(key) when is_atom(key) or is_number(key), do: to_string(key)
  def key_name(key), do: inspect_key(key)

  defp inspect_key(key),
    do: key |> inspect(limit: 8, printable_limit: @max_text) |> String.slice(0, @max_text)

  @doc """
  Sorts numbers by size and the other keys after them by name. Returns at most 32 keys.

      iex> Situ.Studio.Draw.Key.sort_keys([:b, 10, 9, "a"]) |> Enum.map(&Situ.Studio.Draw.Key.key_name/1)
      ["9", "10", "a", "b"]
  """
  @spec sort_keys([term()]) :: [term()]
  def sort_keys(keys) do
    keys
    |> Enum.sort_by(
      &if is_number(&1), do: {0, &1}, else: {1, NaturalOrder.sort_key(key_name(&1))}
    )
    |> Enum.take(@limit)
  end
end
