defmodule Situ.Media.FFmpeg.Log do
  @moduledoc false
  # Collects ffmpeg's error output and converts it to one `Situ.Error`. The first lines are kept and the rest is only
  # counted, because a damaged file can cause thousands.
  alias Situ.Error

  @keep 12

  defstruct lines: [], count: 0

  @type t :: %__MODULE__{lines: [String.t()], count: non_neg_integer()}

  @spec add_line(t(), String.t()) :: t()
  def add_line(%__MODULE__{} = log, line) do
    line = clean_line(line)

    cond do
      line == "" -> log
      log.count < @keep -> %{log | lines: [line | log.lines], count: log.count + 1}
      true -> %{log | count: log.count + 1}
    end
  end

  @doc "Receives all lines of `port` that have arrived."
  @spec take_lines(t(), port()) :: t()
  def take_lines(log, port) do
    receive do
      {^port, {:data, {_eol, line}}} -> log |> add_line(line) |> take_lines(port)
    after
      0 -> log
    end
  end

  @spec list_lines(t()) :: [String.t()]
  def list_lines(%__MODULE__{lines: lines}), do: Enum.reverse(lines)

  @doc "Builds one error from the collected lines."
  @spec to_error(t(), atom(), String.t(), keyword()) :: Error.t()
  def to_error(%__MODULE__{} = log, code, what, details \\ []) do
    meta = Map.merge(%{log: list_lines(log), log_lines: log.count}, Map.new(details[:meta] || []))

    Error.new(code, what,
      why: details[:why] || summarize_lines(log),
      fix: details[:fix],
      meta: meta
    )
  end

  defp summarize_lines(%{count: 0}), do: nil

  defp summarize_lines(%{count: count} = log) do
    first = log |> list_lines() |> Enum.take(2) |> Enum.join("; ")
    "FFmpeg reports: " <> first <> if(count > 2, do: " (and #{count - 2} more)", else: "")
  end

  # Removes addresses and levels, as in "[mov,mp4 @ 0x55f3] [error] moov atom not found".
  defp clean_line(line) do
    line
    |> ensure_utf8()
    |> String.replace(~r/\[([^\]@]*) @ 0x[0-9a-f]+\] /, "\\1: ")
    |> String.replace(~r/\[(error|fatal|panic|warning)\] /, "")
    |> String.trim()
  end

  defp ensure_utf8(line), do: if(String.valid?(line), do: line, else: inspect(line))
end
