defmodule Situ.CLI.Run.Watcher do
  @moduledoc false
  # Waits for the end of a pipeline, shows its progress on the terminal, and stops it when asked to.
  alias Situ.CLI.{Output, Terminal}
  alias Situ.CLI.Run.Summary
  alias Situ.Pipeline

  @interval_ms 200

  @doc """
  Waits until the pipeline has ended. The messages `:stop` and `:time_over` to the calling process stop it. Returns
  `:stopped` after the message `:stop`, and otherwise `:ended`.
  """
  @spec await_end(pid(), Terminal.t() | nil) :: :stopped | :ended
  def await_end(pipeline, terminal),
    do: wait({pipeline, Process.monitor(pipeline)}, terminal, :ended)

  defp wait({pipeline, monitor} = watched, terminal, outcome) do
    receive do
      :stop ->
        Terminal.replace_line(terminal, "")
        Output.warn("Stopping. Press Ctrl-C again to end at once.")
        stop_pipeline(pipeline)
        wait(watched, terminal, :stopped)

      :time_over ->
        stop_pipeline(pipeline)
        wait(watched, terminal, outcome)

      {:DOWN, ^monitor, :process, ^pipeline, _reason} ->
        outcome
    after
      @interval_ms ->
        if terminal, do: show_progress(pipeline, terminal)
        wait(watched, terminal, outcome)
    end
  end

  defp stop_pipeline(pipeline), do: {:ok, _} = Task.start(fn -> Pipeline.stop(pipeline) end)

  # The pipeline may end before it replies.
  defp show_progress(pipeline, terminal) do
    Terminal.replace_line(terminal, pipeline |> Pipeline.info() |> Summary.status_line())
  rescue
    Situ.Error -> :ok
  end
end
