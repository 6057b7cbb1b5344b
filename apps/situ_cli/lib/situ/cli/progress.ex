defmodule Situ.CLI.Progress do
  @moduledoc false
  # Shows a progress bar on standard error if that is a terminal and the work takes longer than 100 ms.

  @spec with_progress(
          String.t(),
          keyword(),
          ((non_neg_integer(), non_neg_integer() -> any()) -> result)
        ) ::
          result
        when result: term()
  def with_progress(label, opts, work) do
    case if(opts[:quiet] || opts[:json], do: nil, else: open_terminal()) do
      nil -> work.(fn _, _ -> :ok end)
      device -> with_bar(label, device, work)
    end
  end

  # Without a shell the VM does not know its terminal, but the system does. The terminal is opened again, because raw
  # writes reach it before the next line of standard output.
  defp open_terminal do
    with {:ok, device} <- File.read_link("/proc/self/fd/2"),
         true <- device =~ ~r{\A/dev/(pts/|tty|console)},
         {:ok, device} <- :file.open(device, [:write, :raw, :binary]) do
      device
    else
      _ -> nil
    end
  end

  defp with_bar(label, device, work) do
    state = :atomics.new(2, signed: true)
    :atomics.put(state, 1, now_ms())
    result = work.(&draw_bar(device, label, {&1, &2}, state))
    if :atomics.get(state, 2) == 1, do: :file.write(device, "\r\e[K")
    _ = :file.close(device)
    result
  end

  defp draw_bar(_device, _label, {_, 0}, _shown), do: :ok

  defp draw_bar(device, label, {done, total}, state) do
    if now_ms() - :atomics.get(state, 1) > 100 do
      :atomics.put(state, 1, now_ms())
      :atomics.put(state, 2, 1)
      :file.write(device, "\r" <> format_bar(label, done, total))
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
