defmodule Situ.CLI.Progress do
  @moduledoc false
  # Shows a progress bar on standard error if that is a terminal and the work takes longer than 100 ms.
  alias Situ.CLI.Terminal

  @spec with_progress(
          String.t(),
          keyword(),
          ((non_neg_integer(), non_neg_integer() -> any()) -> result)
        ) ::
          result
        when result: term()
  def with_progress(label, opts, work) do
    case Terminal.open(opts) do
      nil -> work.(fn _, _ -> :ok end)
      terminal -> with_bar(label, terminal, work)
    end
  end

  defp with_bar(label, terminal, work) do
    drawn = :atomics.new(1, signed: true)
    :atomics.put(drawn, 1, now_ms())
    result = work.(&draw_bar(terminal, label, {&1, &2}, drawn))
    Terminal.close(terminal)
    result
  end

  defp draw_bar(_terminal, _label, {_, 0}, _drawn), do: :ok

  defp draw_bar(terminal, label, {done, total}, drawn) do
    if now_ms() - :atomics.get(drawn, 1) > 100 do
      :atomics.put(drawn, 1, now_ms())
      Terminal.replace_line(terminal, format_bar(label, done, total))
    end
  end

  @doc false
  def format_bar(label, done, total) do
    filled = div(done * 30, total)
    percent = div(done * 100, total)

    "#{label} [#{String.duplicate("#", filled)}#{String.duplicate(".", 30 - filled)}] #{percent} %"
  end

  defp now_ms, do: System.monotonic_time(:millisecond)
end
