defmodule Situ.Studio.Visualizers.Log do
  @moduledoc false
  # Lists the messages around the cursor, each with its time and a short text. Lines of logs also have a level and a
  # name (`Situ.Studio.LogLine`). A filter selects lines by level and text.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Message
  alias Situ.Studio.{Frame, LogLine, StreamReader, ValuePath, Visualizer}

  @earlier 60
  @later 30
  # Messages are searched in steps of this many, and at most this many on each side of the cursor.
  @step 500
  @most 20_000

  @impl true
  def about do
    levels = LogLine.level_names() |> Enum.with_index(1)

    %Visualizer{
      id: "log",
      title: "List",
      panel: :log,
      shapes: :any,
      options: [
        level: [
          type:
            {:in, [{"0", "all"} | for({name, i} <- levels, do: {Integer.to_string(i), name})]},
          title: "Levels from",
          default: "0"
        ],
        words: [type: :text, title: "Text contains"]
      ],
      asks: [:level, :words]
    }
  end

  @impl true
  def instant(channel, _data, %{originating_time: time} = message, %{source: source, spec: spec}) do
    wanted = wanted_lines(Map.get(spec, :props, %{}))
    find = &find_lines(source, spec, {&1, time, &2}, wanted)
    {earlier, all_earlier?} = find.(:before, @earlier)
    {later, all_later?} = find.(:after, @later)
    here = for row <- [build_row(message, spec.path)], wanted.(row), do: row
    before = Enum.reverse(earlier) ++ here

    Frame.json(channel, time, %{
      "rows" => before ++ later,
      "at" => length(before) - 1,
      "searched" => if(all_earlier? and all_later?, do: nil, else: @most)
    })
  end

  # Returns whether a row passes the page's filter.
  defp wanted_lines(props) do
    level =
      with text when is_binary(text) <- props["level"],
           {n, ""} <- Integer.parse(text),
           do: n,
           else: (_ -> 0)

    words =
      with text when is_binary(text) <- props["words"],
           do: text |> String.downcase() |> String.split(),
           else: (_ -> [])

    fn [_, text, of_row, name] ->
      searched = if words == [], do: "", else: String.downcase(name <> " " <> text)
      of_row >= level and Enum.all?(words, &String.contains?(searched, &1))
    end
  end

  # Returns the rows nearest first, and whether no more than the maximum had to be searched.
  defp find_lines(source, spec, place, wanted, found \\ [], searched \\ 0)

  defp find_lines(_, _, _, _, found, searched) when searched >= @most,
    do: {Enum.reverse(found), false}

  defp find_lines(source, spec, {side, time, n}, wanted, found, searched) do
    step = if searched == 0, do: n, else: @step
    messages = StreamReader.list_neighbours(source, spec.stream, side, time, step)
    rows = for m <- messages, row = build_row(m, spec.path), wanted.(row), do: row
    found = Enum.reverse(Enum.take(rows, n)) ++ found
    left = n - length(rows)

    if left <= 0 or length(messages) < step do
      {Enum.reverse(found), true}
    else
      next = {side, List.last(messages).originating_time, left}
      find_lines(source, spec, next, wanted, found, searched + step)
    end
  end

  @doc """
  Returns the time of a message as text, its value at a path in a few words, its level and its name.

      iex> Situ.Studio.Visualizers.Log.build_row(%Situ.Message{data: {:ok, 3}, originating_time: 7}, [])
      ["7", "{:ok, 3}", 0, ""]
  """
  @spec build_row(Message.t(), ValuePath.t()) :: [String.t() | 0..5]
  def build_row(message, path) do
    %{level: level, name: name, text: text} =
      case ValuePath.fetch(message.data, path) do
        {:ok, value} -> LogLine.read(value)
        :error -> %{level: 0, name: "", text: ""}
      end

    [Integer.to_string(message.originating_time), text, level, name]
  end
end
