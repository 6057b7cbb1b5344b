defmodule Situ.CLI.Run.Watcher do
  @moduledoc false
  # Waits for the end of a pipeline, shows its progress on the terminal, and stops it when asked to.
  alias Situ.CLI.{Output, Terminal}
  alias Situ.CLI.Run.Summary
  alias Situ.Pipeline

  @interval_ms 200

  @doc "Returns when the pipeline has ended. The messages `:stop` and `:time_over` to the calling process stop it."
  @spec await_end(pid(), Terminal.t() | nil) :: :ok
  def await_end(pipeline, terminal), do: wait(pipeline, Process.monitor(pipeline), terminal)

  defp wait(pipeline, monitor, terminal) do
    receive do
      :stop ->
        Terminal.replace_line(terminal, "")
        Output.warn("Stopping. Press Ctrl-C again to end at once.")
        stop_and_wait(pipeline, monitor, terminal)

      :time_over ->
        stop_and_wait(pipeline, monitor, terminal)

      {:DOWN, ^monitor, :process, ^pipeline, _reason} ->
        :ok
    after
      @interval_ms ->
        if terminal, do: show_progress(pipeline, terminal)
        wait(pipeline, monitor, terminal)
    end
  end

  defp stop_and_wait(pipeline, monitor, terminal) do
    {:ok, _} = Task.start(fn -> Pipeline.stop(pipeline) end)
    wait(pipeline, monitor, terminal)
  end

  # The pipeline may end before it replies.
  defp show_progress(pipeline, terminal) do
    Terminal.replace_line(terminal, pipeline |> Pipeline.info() |> Summary.status_line())
  rescue
    Situ.Error -> :ok
  end
end
