defmodule Situ.Broadway.Subscriber do
  @moduledoc false
  # The consumer of a stream on behalf of a producer, because a GenStage producer cannot subscribe. It asks the stream
  # for as many messages as Broadway asks the producer.
  use GenStage
  require Logger

  @spec start_link(pid(), keyword()) :: GenServer.on_start()
  def start_link(producer, opts), do: GenStage.start_link(__MODULE__, {producer, opts})

  @spec ask(pid(), pos_integer()) :: :ok
  def ask(subscriber, demand), do: GenStage.cast(subscriber, {:ask, demand})

  @doc """
  Ends the subscription. The producer has received all messages when this returns, unless the pipeline does not respond
  for five seconds.
  """
  @spec cancel(pid()) :: :ok
  def cancel(subscriber) do
    GenStage.call(subscriber, :cancel)
  catch
    :exit, {:timeout, _call} -> :ok
  end

  @impl true
  def init({producer, opts}) do
    send(self(), :subscribe)
    # `demand` is what the producer has asked for and not received.
    {:consumer, %{producer: producer, opts: opts, from: nil, demand: 0, canceller: nil}}
  end

  @impl true
  def handle_info(:subscribe, %{from: nil, canceller: nil} = state) do
    case Situ.GenStage.subscription(state.opts[:pipeline], state.opts[:stream]) do
      {:ok, {pid, opts}} ->
        subscription = [to: pid, cancel: :temporary] ++ opts ++ state.opts[:subscribe]
        GenStage.async_subscribe(self(), subscription)

      {:error, error} ->
        # A pipeline that is not running may start later. All other errors need the user.
        if error.code != :not_running, do: Logger.warning(Exception.message(error))
        Process.send_after(self(), :subscribe, state.opts[:retry])
    end

    {:noreply, [], state}
  end

  def handle_info(_other, state), do: {:noreply, [], state}

  @impl true
  def handle_subscribe(:producer, _opts, from, %{canceller: canceller} = state)
      when canceller != nil do
    GenStage.cancel(from, :normal)
    {:manual, state}
  end

  def handle_subscribe(:producer, _opts, from, state) do
    if state.demand > 0, do: GenStage.ask(from, state.demand)
    {:manual, %{state | from: from}}
  end

  @impl true
  def handle_cancel(_reason, _from, %{canceller: nil} = state) do
    Process.send_after(self(), :subscribe, state.opts[:retry])
    {:noreply, [], %{state | from: nil}}
  end

  def handle_cancel(_reason, from, %{from: from} = state) do
    GenStage.reply(state.canceller, :ok)
    {:noreply, [], %{state | from: nil}}
  end

  def handle_cancel(_reason, _from, state), do: {:noreply, [], state}

  @impl true
  def handle_events(messages, _from, state) do
    send(state.producer, {__MODULE__, messages})
    {:noreply, [], %{state | demand: state.demand - length(messages)}}
  end

  @impl true
  def handle_cast({:ask, demand}, state) do
    if state.from, do: GenStage.ask(state.from, demand)
    {:noreply, [], %{state | demand: state.demand + demand}}
  end

  # The last messages arrive before the stream confirms the cancellation.
  @impl true
  def handle_call(:cancel, canceller, state) do
    if state.from, do: GenStage.cancel(state.from, :normal), else: GenStage.reply(canceller, :ok)
    {:noreply, [], %{state | canceller: canceller}}
  end
end
