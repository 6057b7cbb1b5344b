defmodule Situ.CLI.Store.Progress do
  @moduledoc false
  # A bar on standard error, when a person watches and the work takes longer than a moment.

  @spec show(String.t(), keyword(), ((non_neg_integer(), non_neg_integer() -> any()) -> result)) ::
          result
        when result: term()
  def show(label, opts, work) do
    if opts[:quiet] || opts[:json] || not terminal?(),
      do: work.(fn _, _ -> :ok end),
      else: with_bar(label, work)
  end

  defp terminal?, do: match?({:ok, _}, :io.columns(:standard_error))

  defp with_bar(label, work) do
    shown = :atomics.new(2, signed: true)
    :atomics.put(shown, 1, now())
    result = work.(&draw(label, &1, &2, shown))
    if :atomics.get(shown, 2) == 1, do: IO.write(:stderr, "\r\e[K")
    result
  end

  defp draw(_label, _done, 0, _shown), do: :ok

  defp draw(label, done, total, shown) do
    if now() - :atomics.get(shown, 1) > 100 do
      :atomics.put(shown, 1, now())
      :atomics.put(shown, 2, 1)
      IO.write(:stderr, "\r" <> bar(label, done, total))
    end
  end

  @doc false
  def bar(label, done, total) do
    filled = div(done * 30, total)
    percent = div(done * 100, total)

    "#{label} [#{String.duplicate("#", filled)}#{String.duplicate(".", 30 - filled)}] #{percent} %"
  end

  defp now, do: System.monotonic_time(:millisecond)
end
