defmodule Situ.Ports.Dispatcher do
  @moduledoc false
  # Shares the messages of an output among its consumers outside the pipeline, as GenStage's dispatchers do. A strategy
  # is a pure module that decides which consumer receives which message; this module sends the messages.
  #
  # Messages without a consumer wait, and the output has no room before a consumer asks. Once the pipeline is being
  # stopped, `discard_unclaimed/1` drops messages that no consumer claims.
  # See docs/adr/0166-outputs-can-have-a-dispatcher.md.
  alias Situ.{Error, Message}
  alias Situ.Ports.Dispatcher.{Broadcast, Demand, Partition}
  alias Situ.Ports.Subscriber

  @enforce_keys [:module, :strategy]
  defstruct [:module, :strategy, consumers: [], discards?: false]

  @typedoc "A consumer's pid and the tag of its subscription."
  @type key :: {pid(), term()}
  @typedoc "An error of a consumer's function, or of the dispatcher's own."
  @type failure :: {key() | :dispatcher, Error.t()}
  @type strategy :: term()
  @type spec :: :demand | :broadcast | {:partition, keyword()}
  @type t :: %__MODULE__{
          module: module(),
          strategy: strategy(),
          consumers: [Subscriber.t()],
          discards?: boolean()
        }

  @callback new(keyword()) :: {:ok, strategy()} | {:error, Error.t()}
  @doc "Adds a consumer without demand, or returns the reason for which its subscription is canceled."
  @callback subscribe(strategy(), key(), keyword()) :: {:ok, strategy()} | {:error, term()}
  @callback cancel(strategy(), key()) :: strategy()
  @callback add_demand(strategy(), key(), pos_integer()) :: strategy()
  @doc "Adds messages, which wait for demand."
  @callback push(strategy(), [Message.t()]) :: {[failure()], strategy()}
  @doc "Takes the messages that the consumers have asked for."
  @callback take(strategy()) :: {[{key(), [Message.t(), ...]}], [failure()], strategy()}
  @doc "Returns how many more messages the consumers have asked for; negative while messages wait."
  @callback available_room(strategy()) :: integer()
  @doc "Returns how many messages wait, and how many of them the consumer may still receive."
  @callback waiting_count(strategy()) :: non_neg_integer()
  @callback waiting_count(strategy(), key()) :: non_neg_integer()
  @doc "Drops the waiting messages that no consumer will receive."
  @callback drop_unclaimed(strategy()) :: strategy()

  # A demand without a limit; GenStage's own consumers ask for numbers.
  @endless 1_000_000_000_000

  @spec new(spec() | term()) :: {:ok, t()} | {:error, Error.t()}
  def new(:demand), do: build(Demand, [])
  def new(:broadcast), do: build(Broadcast, [])

  def new({:partition, opts} = spec) do
    if Keyword.keyword?(opts), do: build(Partition, opts), else: {:error, unknown_error(spec)}
  end

  def new(other), do: {:error, unknown_error(other)}

  defp build(module, opts) do
    with {:ok, strategy} <- module.new(opts),
         do: {:ok, %__MODULE__{module: module, strategy: strategy}}
  end

  defp unknown_error(other) do
    Error.new(:bad_dispatcher, "#{inspect(other, limit: 8)} is not a dispatcher",
      fix: "use :demand, :broadcast, or {:partition, partitions: 4}"
    )
  end

  @doc "Adds a consumer, or returns the reason for which its subscription is canceled."
  @spec subscribe(t(), Subscriber.t(), keyword()) :: {:ok, t()} | {:error, term()}
  def subscribe(%__MODULE__{module: module} = dispatcher, sub, opts) do
    with {:ok, strategy} <- module.subscribe(dispatcher.strategy, key(sub), opts),
         do: {:ok, %{dispatcher | strategy: strategy, consumers: dispatcher.consumers ++ [sub]}}
  end

  defp key(%{pid: pid, tag: tag}), do: {pid, tag}

  @doc "Adds demand and sends the messages that wait for it. Returns `:error` for an unknown consumer."
  @spec add_demand(t(), key(), pos_integer() | :infinity) :: {:ok, t()} | :error
  def add_demand(dispatcher, key, :infinity), do: add_demand(dispatcher, key, @endless)

  def add_demand(%__MODULE__{module: module, strategy: strategy} = dispatcher, key, n) do
    if Enum.any?(dispatcher.consumers, &(key(&1) == key)),
      do: {:ok, send_waiting(%{dispatcher | strategy: module.add_demand(strategy, key, n)})},
      else: :error
  end

  @doc "Sends messages within the demand; the rest waits."
  @spec push(t(), [Message.t()]) :: t()
  def push(%__MODULE__{consumers: [], discards?: true} = dispatcher, _messages), do: dispatcher

  def push(%__MODULE__{module: module} = dispatcher, messages) do
    {failures, strategy} = module.push(dispatcher.strategy, messages)
    %{dispatcher | strategy: strategy} |> handle_failures(failures) |> send_waiting()
  end

  defp send_waiting(%{module: module} = dispatcher) do
    {parts, failures, strategy} = module.take(dispatcher.strategy)

    for {{pid, tag}, messages} <- parts,
        do: send(pid, {:"$gen_consumer", {self(), tag}, messages})

    dispatcher = handle_failures(%{dispatcher | strategy: strategy}, failures)
    # Without the consumers that have failed, others may receive more.
    if failures == [], do: drop_unclaimed(dispatcher), else: send_waiting(dispatcher)
  end

  defp drop_unclaimed(%{discards?: true, module: module} = dispatcher),
    do: %{dispatcher | strategy: module.drop_unclaimed(dispatcher.strategy)}

  defp drop_unclaimed(dispatcher), do: dispatcher

  # A function of the dispatcher fails like the component, whose `on_error:` applies; a consumer's function fails alone.
  defp handle_failures(dispatcher, failures) do
    Enum.reduce(failures, dispatcher, fn
      {:dispatcher, error}, dispatcher ->
        send(self(), {:situ_dispatch_failed, error})
        dispatcher

      {key, error}, dispatcher ->
        for sub <- dispatcher.consumers, key(sub) == key, do: Subscriber.send_cancel(sub, error)
        remove_consumers(dispatcher, &(key(&1) == key))
    end)
  end

  @doc "Removes consumers; others receive their unsent messages."
  @spec remove_consumers(t(), (Subscriber.t() -> boolean())) :: t()
  def remove_consumers(%__MODULE__{module: module} = dispatcher, which?) do
    case Enum.split_with(dispatcher.consumers, which?) do
      {[], _consumers} ->
        dispatcher

      {gone, consumers} ->
        for %{monitor: ref} when ref != nil <- gone, do: Process.demonitor(ref, [:flush])
        strategy = Enum.reduce(gone, dispatcher.strategy, &module.cancel(&2, key(&1)))
        send_waiting(%{dispatcher | strategy: strategy, consumers: consumers})
    end
  end

  @doc "Returns how many messages may be posted."
  @spec available_room(t()) :: integer() | :infinity
  def available_room(%__MODULE__{consumers: [], discards?: true}), do: :infinity
  def available_room(%__MODULE__{module: module} = d), do: module.available_room(d.strategy)

  @spec waiting_count(t()) :: non_neg_integer()
  def waiting_count(%__MODULE__{module: module} = d), do: module.waiting_count(d.strategy)

  @doc "Drops from now on messages that no consumer claims, because the pipeline is being stopped."
  @spec discard_unclaimed(t()) :: t()
  def discard_unclaimed(%__MODULE__{discards?: true} = dispatcher), do: dispatcher
  def discard_unclaimed(dispatcher), do: drop_unclaimed(%{dispatcher | discards?: true})

  @doc "Sends the closing mark to the consumers for which no message waits."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{module: module, strategy: strategy} = dispatcher, time) do
    done = Enum.filter(dispatcher.consumers, &(module.waiting_count(strategy, key(&1)) == 0))
    for sub <- done, do: Subscriber.send_close(sub, time)
    if done == [], do: dispatcher, else: remove_consumers(dispatcher, &(&1 in done))
  end

  @doc "Returns whether no consumer and no message is left."
  @spec drained?(t()) :: boolean()
  def drained?(%__MODULE__{consumers: consumers} = d),
    do: consumers == [] and waiting_count(d) == 0
end
