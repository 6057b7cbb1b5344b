defmodule Situ.Studio.Visualizers.Table do
  @moduledoc false
  # Shows the exact values of several streams at the cursor, with the messages before and after, in a table with a row
  # for each stream.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Message
  alias Situ.Studio.{Frame, StreamReader, ValuePath, Visualizer}
  alias Situ.Studio.Visualizers.SharedOptions

  @max_text 2_000

  @impl true
  def about do
    %Visualizer{
      id: "table",
      title: "Table",
      panel: :table,
      shapes: :any,
      options: SharedOptions.near_cursor(),
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, _data, %Message{originating_time: time} = message, context) do
    %{source: source, spec: spec} = context
    find = &List.first(StreamReader.list_neighbours(source, spec.stream, &1, time, 1))

    Frame.json(channel, time, %{
      "now" => describe_message(message, spec.path),
      "before" => describe_message(find.(:before), spec.path),
      "after" => describe_message(find.(:after), spec.path)
    })
  end

  defp describe_message(nil, _path), do: nil

  defp describe_message(message, path) do
    text =
      case ValuePath.fetch(message.data, path) do
        {:ok, value} -> exact_text(value)
        :error -> ""
      end

    [Integer.to_string(message.originating_time), text]
  end

  @doc """
  Writes a value without rounding. Only long texts and collections are cut, which three dots show.

      iex> alias Situ.Studio.Visualizers.Table
      iex> Enum.map([123456789.123, 9_007_199_254_740_993, "go", true, nil], &Table.exact_text/1)
      ["123456789.123", "9007199254740993", "go", "true", ""]
  """
  @spec exact_text(term()) :: String.t()
  def exact_text(nil), do: ""
  def exact_text(value) when is_number(value) or is_atom(value), do: to_string(value)

  def exact_text(value) when is_binary(value) do
    cond do
      not String.valid?(value) -> inspect(value, limit: 64)
      String.length(value) > @max_text -> String.slice(value, 0, @max_text) <> "..."
      true -> value
    end
  end

  def exact_text(value), do: inspect(value, limit: 50, printable_limit: 200)
end
