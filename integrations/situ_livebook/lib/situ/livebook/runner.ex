defmodule Situ.Livebook.Runner do
  @moduledoc false
  # Starts and stops a pipeline by two buttons. It stops the pipeline when its cell is evaluated again.
  use GenServer, restart: :temporary, shutdown: 15_000

  def start_link(arg), do: GenServer.start_link(__MODULE__, arg)

  @impl true
  def init({spec, opts, names, {start, stop, frame}}) do
    Process.flag(:trap_exit, true)
    Kino.Control.subscribe(start, :start)
    Kino.Control.subscribe(stop, :stop)
    {:ok, %{spec: spec, opts: opts, names: names, frame: frame, pipeline: nil}}
  end

  @impl true
  def handle_info({:start, _event}, %{pipeline: nil} = state) do
    case Situ.Pipeline.start(state.spec, state.opts) do
      {:ok, pipeline} ->
        Process.monitor(pipeline)
        streams = for name <- state.names, do: Situ.Livebook.show({pipeline, name})

        Kino.Frame.render(
          state.frame,
          Kino.Layout.grid([Situ.Livebook.graph(pipeline) | streams])
        )

        {:noreply, %{state | pipeline: pipeline}}

      {:error, error} ->
        Kino.Frame.render(state.frame, Kino.Text.new(Exception.message(error)))
        {:noreply, state}
    end
  end

  def handle_info({:start, _event}, state), do: {:noreply, state}

  def handle_info({:stop, _event}, %{pipeline: pipeline} = state) do
    if pipeline, do: stop_pipeline(pipeline)
    {:noreply, state}
  end

  def handle_info({:DOWN, _, :process, pipeline, _}, %{pipeline: pipeline} = state),
    do: {:noreply, %{state | pipeline: nil}}

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, %{pipeline: pipeline}), do: if(pipeline, do: stop_pipeline(pipeline))

  # The pipeline may have ended at this moment.
  defp stop_pipeline(pipeline) do
    Situ.Pipeline.stop(pipeline)
  catch
    :exit, _ -> :ok
  end
end
