defmodule Situ.Livebook.GraphOutput do
  @moduledoc false
  # Draws the graph of a pipeline into a frame, until the pipeline ends.
  use GenServer, restart: :temporary

  def start_link(arg), do: GenServer.start_link(__MODULE__, arg)

  @impl true
  def init({frame, {pipeline, every_ms}}) do
    send(self(), :draw)
    {:ok, %{frame: frame, pipeline: pipeline, every_ms: every_ms, drawn: nil}}
  end

  @impl true
  def handle_info(:draw, state) do
    case fetch_info(state.pipeline) do
      {:ok, %{state: :completed} = snapshot} -> {:stop, :normal, draw(state, snapshot)}
      {:ok, snapshot} -> {:noreply, state |> draw(snapshot) |> schedule()}
      :ended -> {:stop, :normal, state}
    end
  end

  defp fetch_info(pipeline) do
    {:ok, Situ.Pipeline.info(pipeline)}
  rescue
    Situ.Error -> :ended
  catch
    :exit, _ -> :ended
  end

  defp draw(state, snapshot) do
    text = Situ.Livebook.to_mermaid(snapshot)

    if text != state.drawn,
      do: Kino.Frame.render(state.frame, Kino.Mermaid.new(text, download: false))

    %{state | drawn: text}
  end

  defp schedule(state) do
    Process.send_after(self(), :draw, state.every_ms)
    state
  end
end
