defmodule Situ.Python.LogLines do
  @moduledoc false
  # The output of a worker, as log entries: the level of each line, a limit of lines per second, and the last lines for
  # the error if the worker ends. Pure.
  @kept 20
  @per_second 200
  @second 1_000

  defstruct tail: :queue.new(), count: 0, second: nil, dropped: 0

  @type t :: %__MODULE__{
          tail: :queue.queue(String.t()),
          count: non_neg_integer(),
          second: integer() | nil,
          dropped: non_neg_integer()
        }
  @type entry :: {Logger.level(), String.t()}

  @doc """
  Adds a line at a monotonic time in ms. Returns the entries to log: none if there were too many in this second, and a
  note about dropped lines in the next one.

      iex> {[{:warning, "slow"}], lines} = Situ.Python.LogLines.add_line(%Situ.Python.LogLines{}, "<4>slow", 0)
      iex> Situ.Python.LogLines.last_lines(lines)
      "slow"
  """
  @spec add_line(t(), binary(), now :: integer()) :: {[entry()], t()}
  def add_line(lines, line, now) do
    {level, text} = line |> clean_text() |> split_level()
    {notes, lines} = lines |> keep_line(text) |> start_second(div(now, @second))

    if lines.count < @per_second,
      do: {notes ++ [{level, text}], %{lines | count: lines.count + 1}},
      else: {notes, %{lines | dropped: lines.dropped + 1}}
  end

  defp start_second(%{second: second} = lines, second), do: {[], lines}

  defp start_second(lines, second) do
    note =
      {:warning, "#{lines.dropped} lines were not logged: the limit is #{@per_second} a second"}

    notes = if lines.dropped > 0, do: [note], else: []
    {notes, %{lines | second: second, count: 0, dropped: 0}}
  end

  defp keep_line(lines, text) do
    tail = :queue.in(text, lines.tail)
    %{lines | tail: if(:queue.len(tail) > @kept, do: :queue.drop(tail), else: tail)}
  end

  # The prefixes of journald, which the worker's log handler writes.
  defp split_level("<3>" <> text), do: {:error, text}
  defp split_level("<4>" <> text), do: {:warning, text}
  defp split_level("<6>" <> text), do: {:info, text}
  defp split_level("<7>" <> text), do: {:debug, text}
  defp split_level(text), do: {:info, text}

  defp clean_text(bytes), do: if(String.printable?(bytes), do: bytes, else: inspect(bytes))

  @doc "Returns the last lines."
  @spec last_lines(t()) :: String.t()
  def last_lines(lines), do: lines.tail |> :queue.to_list() |> Enum.join("\n")
end
