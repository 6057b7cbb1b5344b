defmodule Situ.Studio.NaturalOrder do
  @moduledoc false
  # Sorts names in natural order, in which numbers within a name are compared by value.
  # Longer runs of digits are unlikely to be numbers, so they are compared as text.
  @digits 15

  @type key :: [{0, non_neg_integer()} | {1, String.t()}]

  @doc """
  Returns the sort key of a name.

      iex> Enum.sort_by(["Sensor10", "Sensor9", "B", "Sensor9.x"], &Situ.Studio.NaturalOrder.sort_key/1)
      ["B", "Sensor9", "Sensor9.x", "Sensor10"]
  """
  @spec sort_key(String.t()) :: key()
  def sort_key(name) do
    for part <- Regex.split(~r/[0-9]+/, name, include_captures: true, trim: true),
        do: part_key(part)
  end

  defp part_key(<<c, _::binary>> = part) when c in ?0..?9 and byte_size(part) <= @digits,
    do: {0, String.to_integer(part)}

  defp part_key(part), do: {1, part}
end
