defmodule Situ.Ports.Outputs do
  @moduledoc false
  # The outputs of one step of a stage, by name. With `demand: :accumulate` nothing is sent, whatever the demand, until
  # it is `:forward`. A `dispatcher` serves the consumers outside the pipeline of a step with one output.
  alias Situ.Graph.Vertex
  alias Situ.Ports.{Dispatcher, Output, PostingRules, Subscriber}

  defstruct own: [], demand: :forward, dispatcher: nil

  @type t :: %__MODULE__{
          own: [{atom(), Output.t()}],
          demand: :forward | :accumulate,
          dispatcher: Dispatcher.t() | nil
        }

  @doc "Builds the outputs of a vertex; the ones from `first` on in `marks` hold their recorded progress."
  @spec new(Vertex.t(), Output.marks() | nil, non_neg_integer()) :: t()
  def new(vertex, marks, first) do
    own =
      for {{name, port}, index} <- vertex.outputs |> Enum.sort() |> Enum.with_index(first) do
        output = Output.new(name, vertex.path, port.source_id, vertex.on_same_time)
        {name, Output.attach_marks(output, marks, index)}
      end

    %__MODULE__{own: own}
  end

  @spec fetch(t(), atom()) :: {:ok, Output.t()} | :error
  def fetch(%__MODULE__{own: own}, name) do
    case List.keyfind(own, name, 0) do
      {_, output} -> {:ok, output}
      nil -> :error
    end
  end

  @spec list_names(t()) :: [atom()]
  def list_names(%__MODULE__{own: own}), do: Enum.map(own, &elem(&1, 0))

  @spec put(t(), Output.t()) :: t()
  def put(%__MODULE__{own: [{name, _}]} = outputs, %{port: %{name: name}} = output),
    do: %{outputs | own: [{name, output}]}

  def put(%__MODULE__{own: own} = outputs, %{port: %{name: name}} = output),
    do: %{outputs | own: List.keyreplace(own, name, 0, {name, output})}

  @spec list_all(t()) :: [Output.t()]
  def list_all(%__MODULE__{own: own}), do: for({_, output} <- own, do: output)

  @spec map_outputs(t(), (Output.t() -> Output.t())) :: t()
  def map_outputs(%__MODULE__{own: [{name, output}]} = outputs, fun),
    do: %{outputs | own: [{name, fun.(output)}]}

  def map_outputs(%__MODULE__{own: own} = outputs, fun),
    do: %{outputs | own: for({name, output} <- own, do: {name, fun.(output)})}

  @doc """
  Gives the only output a dispatcher. A process that replaces this one then posts again what it receives again, because
  messages may have waited in the dispatcher.
  """
  @spec put_dispatcher(t(), Dispatcher.t()) :: t()
  def put_dispatcher(%__MODULE__{own: [{name, output}]} = outputs, dispatcher),
    do: %{outputs | own: [{name, Output.forget_marks(output)}], dispatcher: dispatcher}

  @doc "Drops from now on messages that no consumer outside claims, because the pipeline is being stopped."
  @spec discard_unclaimed(t()) :: t()
  def discard_unclaimed(%__MODULE__{dispatcher: dispatcher} = outputs),
    do: %{outputs | dispatcher: Dispatcher.discard_unclaimed(dispatcher)}

  @doc "Returns how many messages may be posted now."
  @spec available_room(t()) :: integer() | :infinity
  def available_room(%__MODULE__{demand: :accumulate}), do: 0

  def available_room(%__MODULE__{own: [{_, output}], dispatcher: nil}),
    do: Output.available_room(output)

  # An atom is more than any number.
  def available_room(%__MODULE__{own: [{_, output}], dispatcher: dispatcher}) do
    case Dispatcher.available_room(dispatcher) do
      :infinity -> Output.available_room(output)
      room -> min(Output.available_room(output), room - output.pending_n)
    end
  end

  def available_room(%__MODULE__{own: own}), do: least_room(own, :infinity)

  defp least_room([], room), do: room

  defp least_room([{_, output} | rest], room),
    do: least_room(rest, min(room, Output.available_room(output)))

  @doc "Returns how many posted messages wait for the next flush, at most, at one output."
  @spec pending_count(t()) :: non_neg_integer()
  def pending_count(%__MODULE__{own: [{_, %{pending_n: n}}]}), do: n
  def pending_count(%__MODULE__{own: own}), do: most_pending(own, 0)

  defp most_pending([], most), do: most
  defp most_pending([{_, %{pending_n: n}} | rest], most), do: most_pending(rest, max(n, most))

  @doc "Sends pending messages and closing marks at clock time `now`."
  @spec flush(t(), Situ.Time.t()) :: t()
  def flush(%__MODULE__{own: []} = outputs, _now), do: outputs
  def flush(%__MODULE__{demand: :accumulate} = outputs, _now), do: outputs

  def flush(%__MODULE__{own: [{_, %{pending: [], ending: nil}}]} = outputs, _now), do: outputs

  def flush(%__MODULE__{own: [{name, output}], dispatcher: dispatcher} = outputs, now)
      when dispatcher != nil do
    dispatcher =
      case Output.list_pending(output) do
        [] -> dispatcher
        messages -> Dispatcher.push(dispatcher, messages)
      end

    close_dispatcher(%{outputs | own: [{name, Output.flush(output, now)}], dispatcher: dispatcher})
  end

  def flush(%__MODULE__{own: own} = outputs, now),
    do: %{outputs | own: for({name, output} <- own, do: {name, Output.flush(output, now)})}

  # Its consumers receive the closing mark after the messages that wait for them.
  defp close_dispatcher(%{own: [{_, %{ending: {:closed, time}}}]} = outputs),
    do: %{outputs | dispatcher: Dispatcher.close(outputs.dispatcher, time)}

  defp close_dispatcher(outputs), do: outputs

  @doc "Takes the batches that wait for other steps of the stage: `[{tag, batches}]`."
  @spec take_local(t()) :: {[{term(), [Situ.Delivery.Batch.t()]}], t()}
  def take_local(%__MODULE__{own: own} = outputs) do
    {own, taken} =
      Enum.map_reduce(own, [], fn {name, output}, taken ->
        {more, output} = Output.take_local(output)
        {{name, output}, more ++ taken}
      end)

    {taken, %{outputs | own: own}}
  end

  @doc "Sets whether messages are withheld until the pipeline knows the end; `flush/2` sends them after that."
  @spec set_withheld(t(), boolean()) :: t()
  def set_withheld(%__MODULE__{} = outputs, withheld?),
    do: map_outputs(outputs, &Output.set_withheld(&1, withheld?))

  @spec any_withheld?(t()) :: boolean()
  def any_withheld?(%__MODULE__{own: own}),
    do: Enum.any?(own, &match?({_, %{ending: {:withheld, _}}}, &1))

  @doc "Returns whether messages wait for their time."
  @spec any_held?(t()) :: boolean()
  def any_held?(%__MODULE__{own: own}), do: Enum.any?(own, &Output.messages_held?(elem(&1, 1)))

  @doc "Returns when the first held message is due, or `nil`."
  @spec next_time(t()) :: Situ.Time.t() | nil
  # `nil` is more than any number.
  def next_time(%__MODULE__{own: own}),
    do: Enum.reduce(own, nil, fn {_, output}, first -> min(Output.next_time(output), first) end)

  @spec release_due(t(), Situ.Time.t()) :: t()
  def release_due(%__MODULE__{} = outputs, now),
    do: map_outputs(outputs, &PostingRules.release_due(&1, now))

  @doc "Adds demand of one subscriber; `:error` if the subscriber is unknown."
  @spec add_demand(t(), {pid(), term()}, pos_integer() | :infinity) :: {:ok, t()} | :error
  def add_demand(%__MODULE__{own: [{name, output}], dispatcher: dispatcher} = outputs, from, n) do
    case Output.add_demand(output, from, n) do
      {:ok, output} -> {:ok, %{outputs | own: [{name, output}]}}
      :error when dispatcher == nil -> :error
      :error -> add_outside_demand(outputs, from, n)
    end
  end

  def add_demand(%__MODULE__{own: own} = outputs, from, n),
    do: update_first(own, outputs, &Output.add_demand(&1, from, n))

  defp add_outside_demand(outputs, from, n) do
    with {:ok, dispatcher} <- Dispatcher.add_demand(outputs.dispatcher, from, n),
         do: {:ok, close_dispatcher(%{outputs | dispatcher: dispatcher})}
  end

  @doc "Adds a consumer outside the pipeline, or returns why it is refused."
  @spec subscribe(t(), atom(), Subscriber.t(), keyword()) :: {:ok, t()} | {:error, term()}
  def subscribe(%__MODULE__{dispatcher: nil} = outputs, name, sub, _opts) do
    {:ok, output} = fetch(outputs, name)
    {:ok, put(outputs, Output.subscribe(output, sub))}
  end

  def subscribe(%__MODULE__{dispatcher: dispatcher} = outputs, _name, sub, opts) do
    with {:ok, dispatcher} <- Dispatcher.subscribe(dispatcher, sub, opts),
         do: {:ok, close_dispatcher(%{outputs | dispatcher: dispatcher})}
  end

  @doc "Sends a subscriber with a lossy policy the newest messages."
  @spec refresh_subscriber(t(), {pid(), term()}) :: {:ok, t()} | :error
  def refresh_subscriber(%__MODULE__{own: own} = outputs, from),
    do: update_first(own, outputs, &Output.refresh_subscriber(&1, from))

  defp update_first([], _outputs, _fun), do: :error

  defp update_first([{_, output} | rest], outputs, fun) do
    case fun.(output) do
      {:ok, output} -> {:ok, put(outputs, output)}
      :error -> update_first(rest, outputs, fun)
    end
  end

  @doc "Updates every subscriber with this tag."
  @spec map_tagged(t(), term(), (Subscriber.t() -> Subscriber.t())) :: t()
  def map_tagged(%__MODULE__{} = outputs, tag, fun),
    do: map_outputs(outputs, &Output.map_tagged(&1, tag, fun))

  @doc "Returns whether no message waits for the demand of a subscriber that must receive all."
  @spec all_sent?(t()) :: boolean()
  def all_sent?(%__MODULE__{own: own, dispatcher: dispatcher}) do
    Enum.all?(own, &Output.all_sent?(elem(&1, 1))) and
      (dispatcher == nil or Dispatcher.waiting_count(dispatcher) == 0)
  end

  @doc "Records that everything posted has left the stage."
  @spec record_progress(t()) :: t()
  def record_progress(%__MODULE__{} = outputs),
    do: map_outputs(outputs, &Output.record_progress/1)

  @doc "Returns whether every subscriber has received all its messages and the closing mark."
  @spec drained?(t()) :: boolean()
  def drained?(%__MODULE__{own: own, dispatcher: dispatcher}) do
    Enum.all?(own, &Output.drained?(elem(&1, 1))) and
      (dispatcher == nil or Dispatcher.drained?(dispatcher))
  end

  @spec list_subscribers(t()) :: [Subscriber.t()]
  def list_subscribers(%__MODULE__{own: own, dispatcher: nil}),
    do: for({_, %{subs: s}} <- own, sub <- s, do: sub)

  def list_subscribers(%__MODULE__{dispatcher: dispatcher} = outputs),
    do: list_subscribers(%{outputs | dispatcher: nil}) ++ dispatcher.consumers

  @doc "Returns how many messages wait for demand: the sum of the outputs' largest queues."
  @spec buffered_count(t()) :: non_neg_integer()
  def buffered_count(%__MODULE__{own: own, dispatcher: nil}),
    do: Enum.reduce(own, 0, fn {_, output}, n -> n + Output.buffered_count(output) end)

  def buffered_count(%__MODULE__{own: [{_, output}], dispatcher: dispatcher}),
    do: Output.buffered_count(output) + Dispatcher.waiting_count(dispatcher)

  @doc "Removes subscribers and the messages that wait for them."
  @spec remove_subscribers(t(), (Subscriber.t() -> boolean())) :: t()
  def remove_subscribers(%__MODULE__{} = outputs, which?) do
    for %{monitor: ref} = sub when ref != nil <- list_subscribers(outputs),
        which?.(sub),
        do: Process.demonitor(ref, [:flush])

    outputs = map_outputs(outputs, &Output.cancel_subscribers(&1, which?))
    if outputs.dispatcher == nil, do: outputs, else: remove_outside(outputs, which?)
  end

  defp remove_outside(outputs, which?),
    do:
      close_dispatcher(%{
        outputs
        | dispatcher: Dispatcher.remove_consumers(outputs.dispatcher, which?)
      })

  @doc "Ends external consumers with `reason`; internal ones close in their order."
  @spec abandon_external(t(), term(), Situ.Time.t()) :: t()
  def abandon_external(%__MODULE__{} = outputs, reason, now) do
    outputs = flush(set_withheld(outputs, false), now)

    for %{monitor: ref} = sub when ref != nil <- list_subscribers(outputs),
        do: Subscriber.send_cancel(sub, reason)

    remove_subscribers(outputs, &(&1.monitor != nil))
  end

  @doc "Sends one subscriber all its waiting messages, regardless of demand, and the closing mark."
  @spec cut_subscriber(t(), term(), Situ.Time.t()) :: t()
  def cut_subscriber(%__MODULE__{} = outputs, tag, time),
    do: map_outputs(outputs, &Output.cut_subscriber(&1, tag, time))

  @doc "Returns a value that changes when a message is emitted."
  @spec progress_mark(t()) :: term()
  def progress_mark(%__MODULE__{own: own}),
    do: for({_, output} <- own, do: {output.seq, output.last_time})

  @doc "Returns how many messages were posted."
  @spec posted_count(t()) :: non_neg_integer()
  def posted_count(%__MODULE__{own: [{_, output}]}), do: output.seq

  def posted_count(%__MODULE__{own: own}),
    do: Enum.reduce(own, 0, fn {_, output}, n -> n + output.seq end)

  @doc "Returns how many messages had been posted before, or were dropped because of their time."
  @spec repeated_count(t()) :: non_neg_integer()
  def repeated_count(%__MODULE__{own: own}),
    do: Enum.reduce(own, 0, fn {_, output}, n -> n + output.repeated end)
end
