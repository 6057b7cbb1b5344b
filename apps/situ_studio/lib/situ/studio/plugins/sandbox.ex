defmodule Situ.Studio.Plugins.Sandbox do
  @moduledoc false
  # Runs code of a plug-in in a separate process. Code that fails, hangs or uses too much memory
  # affects only its panel.
  @ms 5_000
  # The heap limit in words, which is 1 GB.
  @words 125_000_000

  @doc """
  Returns the result of `work`, or the reason if it fails or does not return within `ms`
  milliseconds.

      iex> Situ.Studio.Plugins.Sandbox.run(fn -> 1 + 1 end)
      {:ok, 2}
      iex> Situ.Studio.Plugins.Sandbox.run(fn -> exit(:tired) end)
      {:error, "it ended: :tired"}
      iex> Situ.Studio.Plugins.Sandbox.run(fn -> Process.sleep(:infinity) end, 20)
      {:error, "it did not return within 20 ms"}
  """
  @spec run((() -> result), pos_integer()) :: {:ok, result} | {:error, String.t()}
        when result: term()
  def run(work, ms \\ @ms) do
    task = Task.Supervisor.async_nolink(Situ.Studio.Tasks, fn -> run_limited(work) end)

    case Task.yield(task, ms) || Task.shutdown(task, :brutal_kill) do
      {:ok, answer} -> answer
      {:exit, :killed} -> {:error, "it took more than 1 GB of memory"}
      {:exit, reason} -> {:error, "it ended: #{inspect(reason, limit: 5)}"}
      nil -> {:error, "it did not return within #{ms} ms"}
    end
  end

  defp run_limited(work) do
    Process.flag(:max_heap_size, %{size: @words, kill: true, error_logger: false})
    {:ok, work.()}
  rescue
    error -> {:error, Exception.message(error)}
  catch
    :throw, value -> {:error, "it threw #{inspect(value, limit: 5)}"}
    :exit, reason -> {:error, "it ended: #{inspect(reason, limit: 5)}"}
  end
end
