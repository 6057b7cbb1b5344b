defmodule Situ.Studio.Visualizers.Log do
  @moduledoc false
  # Lists the messages around the cursor, each with its time and a short text.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Message
  alias Situ.Studio.Draw.Segments
  alias Situ.Studio.{Frame, ValuePath, Visualizer, StreamReader}

  @earlier 60
  @later 30

  @impl true
  def about,
    do: %Visualizer{id: "log", title: "List", panel: :log, shapes: :any}

  @impl true
  def instant(channel, _data, %{originating_time: time} = message, %{source: source, spec: spec}) do
    before = StreamReader.list_neighbours(source, spec.stream, :before, time, @earlier)
    later = StreamReader.list_neighbours(source, spec.stream, :after, time, @later)
    rows = for m <- Enum.reverse(before) ++ [message | later], do: build_row(m, spec.path)
    Frame.json(channel, time, %{"rows" => rows, "at" => length(before)})
  end

  @doc """
  Returns the time of a message as text, and its value at a path in a few words.

      iex> Situ.Studio.Visualizers.Log.build_row(%Situ.Message{data: {:ok, 3}, originating_time: 7}, [])
      ["7", "{:ok, 3}"]
  """
  @spec build_row(Message.t(), ValuePath.t()) :: [String.t()]
  def build_row(message, path) do
    said =
      case ValuePath.fetch(message.data, path) do
        {:ok, value} -> Segments.value_label(value)
        :error -> ""
      end

    [Integer.to_string(message.originating_time), said]
  end
end
