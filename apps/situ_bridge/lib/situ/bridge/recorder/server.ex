defmodule Situ.Bridge.Recorder.Server do
  @moduledoc false
  # Owns the file while a pipeline writes it: creates it when the pipeline starts, flushes complete chunks to the
  # operating system every second, and writes the index when the last stream or the pipeline has ended.
  use GenServer, restart: :temporary
  alias Situ.Error

  @flush_ms 1_000

  @doc "Starts the server without a link, so that it can still write the index after a pipeline crashes."
  def start(pipeline, file), do: GenServer.start(__MODULE__, {pipeline, file})

  def expect_stream(server), do: GenServer.call(server, :expect)
  def open_file(server), do: call_server(server, :open)

  def write_messages(server, topic, messages, opts),
    do: call_server(server, {:write, topic, messages, opts})

  def finish_stream(server), do: call_server(server, :done)

  # Disks may be slow, so calls have no timeout.
  defp call_server(server, request) do
    GenServer.call(server, request, :infinity)
  catch
    :exit, _ -> {:error, Error.new(:closed, "the file is closed")}
  end

  @impl true
  def init({pipeline, {module, path, opts}}) do
    Process.monitor(pipeline)
    {:ok, %{module: module, path: path, opts: opts, writer: nil, streams: 0, dirty?: false}}
  end

  @impl true
  def handle_call(:expect, _from, state), do: {:reply, :ok, %{state | streams: state.streams + 1}}

  def handle_call(:open, _from, %{writer: nil} = state) do
    case state.module.create(state.path, state.opts) do
      {:ok, writer} ->
        Process.send_after(self(), :flush, @flush_ms)
        {:reply, {:ok, nil}, %{state | writer: writer}}

      error ->
        {:reply, error, state}
    end
  end

  def handle_call(:open, _from, state), do: {:reply, {:ok, nil}, state}

  def handle_call({:write, topic, messages, opts}, _from, state) do
    case append_messages(state, topic, messages, opts) do
      {:ok, writer} -> {:reply, {:ok, nil}, %{state | writer: writer, dirty?: true}}
      error -> {:reply, error, state}
    end
  end

  def handle_call(:done, _from, %{streams: 1} = state),
    do: {:stop, :normal, finish_file(state), %{state | writer: nil}}

  def handle_call(:done, _from, state),
    do: {:reply, {:ok, nil}, %{state | streams: state.streams - 1}}

  defp append_messages(%{module: module, writer: writer}, topic, messages, opts) do
    Enum.reduce_while(messages, {:ok, writer}, fn message, {:ok, writer} ->
      case module.write(writer, topic, message, opts) do
        {:ok, writer} -> {:cont, {:ok, writer}}
        error -> {:halt, error}
      end
    end)
  end

  @impl true
  def handle_info(:flush, %{writer: nil} = state), do: {:noreply, state}

  def handle_info(:flush, state) do
    Process.send_after(self(), :flush, @flush_ms)
    {:noreply, if(state.dirty?, do: flush_writer(state), else: state)}
  end

  def handle_info({:DOWN, _, :process, _, _}, state) do
    finish_file(state)
    {:stop, :normal, %{state | writer: nil}}
  end

  # A failed flush fails again on the next write, which reports the error.
  defp flush_writer(state) do
    case state.module.flush(state.writer) do
      {:ok, writer} -> %{state | writer: writer, dirty?: false}
      {:error, _} -> state
    end
  end

  defp finish_file(%{writer: nil}), do: {:ok, nil}
  defp finish_file(state), do: state.module.finish(state.writer)
end
