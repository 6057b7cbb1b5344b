defmodule Situ.CLI.TransferProgress do
  @moduledoc false
  # Shows the progress of a transfer on the terminal: a bar, the bytes, the rate and the time that is left.
  alias Situ.CLI.{Output, Progress, Terminal}

  # The rate covers the last 10 to 20 s.
  @window_ms 10_000

  @doc "Runs a transfer with a function that reports the bytes that are done and all bytes."
  @spec with_progress(
          String.t(),
          keyword(),
          ((non_neg_integer(), non_neg_integer() -> any()) -> result)
        ) :: result
        when result: term()
  def with_progress(label, opts, work) do
    case Terminal.open(opts) do
      nil -> work.(fn _, _ -> :ok end)
      terminal -> with_line(label, terminal, work)
    end
  end

  defp with_line(label, terminal, work) do
    now = now_ms()
    marks = :ets.new(__MODULE__, [:public])
    :ets.insert(marks, marks: {[{now, 0}], now})
    result = work.(&draw(terminal, marks, label, {&1, &2}))
    :ets.delete(marks)
    Terminal.close(terminal)
    result
  end

  defp draw(terminal, table, label, {done, total}) do
    now = now_ms()
    [marks: {marks, drawn}] = :ets.lookup(table, :marks)
    marks = add_mark(marks, {now, done})
    drawn? = now - drawn > 100
    :ets.insert(table, marks: {marks, if(drawn?, do: now, else: drawn)})
    if drawn?, do: Terminal.replace_line(terminal, format_line(label, {done, total}, marks, now))
  end

  @doc "Adds a mark `{ms, bytes}` if the last one is older than the window, and keeps the last two."
  @spec add_mark([{integer(), non_neg_integer()}], {integer(), non_neg_integer()}) ::
          [{integer(), non_neg_integer()}]
  def add_mark([{last, _} | _] = marks, {now, _} = mark) when now - last >= @window_ms,
    do: Enum.take([mark | marks], 2)

  def add_mark(marks, _mark), do: marks

  @doc """
  Formats the line.

      iex> Situ.CLI.TransferProgress.format_line("push", {50_000_000, 100_000_000}, [{0, 0}], 5_000)
      "push [###############...............] 50 %  50.0 MB of 100.0 MB, 10.0 MB/s, 5 s left"
  """
  @spec format_line(
          String.t(),
          {non_neg_integer(), non_neg_integer()},
          [{integer(), non_neg_integer()}],
          integer()
        ) :: String.t()
  def format_line(label, {done, total}, marks, now) do
    {start, before} = List.last(marks)
    rate = (done - before) * 1000 / max(now - start, 1)
    done = min(done, total)

    "#{Progress.format_bar(label, done, max(total, 1))}  #{Output.format_bytes(done)} of " <>
      "#{Output.format_bytes(total)}#{format_rate(rate, total - done)}"
  end

  defp format_rate(rate, _left) when rate <= 0, do: ""

  defp format_rate(rate, left),
    do: ", #{Output.format_bytes(round(rate))}/s, #{format_left(ceil(left / rate))} left"

  defp format_left(seconds) when seconds < 120, do: "#{seconds} s"
  defp format_left(seconds) when seconds < 7200, do: "#{div(seconds, 60)} min"
  defp format_left(seconds), do: "#{div(seconds, 3600)} h"

  defp now_ms, do: System.monotonic_time(:millisecond)
end
