defmodule Situ.Store.Test.Queue do
  @moduledoc false
  # A GenStage producer of numbers that sends unacknowledged events again to its next consumer, as a message
  # queue does. Acknowledged numbers are appended to a file, which survives a kill of the system.
  use GenServer

  defmodule Message do
    @moduledoc false
    defstruct [:data, :acknowledger, status: :ok]
  end

  def start(numbers, file), do: GenServer.start(__MODULE__, {numbers, file})

  def left(queue), do: GenServer.call(queue, :left)

  @doc "Returns the acknowledged numbers in the file."
  def acknowledged(file) do
    case File.read(file) do
      {:ok, text} -> text |> String.split("\n", trim: true) |> Enum.map(&String.to_integer/1)
      {:error, :enoent} -> []
    end
  end

  # The callback of an acknowledger.
  def ack(queue, successful, failed) do
    numbers = &for(%{acknowledger: {_, _, n}} <- &1, do: n)
    GenServer.call(queue, {:ack, numbers.(successful), numbers.(failed)})
  end

  @impl true
  def init({numbers, file}) do
    {:ok, device} = :file.open(file, [:append, :raw])
    {:ok, %{waiting: numbers, sent: [], demand: 0, sub: nil, device: device}}
  end

  @impl true
  def handle_call(:left, _from, state), do: {:reply, length(state.waiting ++ state.sent), state}

  def handle_call({:ack, good, []}, _from, state) do
    :ok = :file.write(state.device, Enum.map(good, &"#{&1}\n"))
    {:reply, :ok, %{state | sent: state.sent -- good}}
  end

  @impl true
  def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, _, _}}, state) do
    Process.monitor(pid)
    {:noreply, %{state | sub: {pid, ref}, demand: 0}}
  end

  def handle_info({:"$gen_producer", sub, {:ask, n}}, %{sub: sub} = state),
    do: {:noreply, deliver(%{state | demand: state.demand + n})}

  def handle_info({:DOWN, _, _, pid, _}, %{sub: {pid, _}} = state),
    do: {:noreply, %{state | sub: nil, sent: [], waiting: Enum.sort(state.sent) ++ state.waiting}}

  def handle_info(_other, state), do: {:noreply, state}

  defp deliver(%{sub: {pid, ref}} = state) do
    {now, later} = Enum.split(state.waiting, state.demand)
    events = for n <- now, do: %Message{data: n, acknowledger: {__MODULE__, self(), n}}
    if events != [], do: send(pid, {:"$gen_consumer", {self(), ref}, events})
    %{state | waiting: later, sent: now ++ state.sent, demand: state.demand - length(now)}
  end
end
