defmodule Situ.Ports.Outputs do
  @moduledoc false
  # The outputs of a stage: those of its component or chain and, if light operators follow a component in the same
  # process, the output of the last operator, `tail`. In that case the component's own output has no subscribers.
  alias Situ.Graph.Vertex
  alias Situ.Ports.{Output, PostingRules, Subscriber}

  defstruct own: [], tail: nil, left: [], demand: :forward

  @typedoc """
  `left` holds messages that the operators after the component have not handled yet; it emits no more until then. With
  `demand: :accumulate` nothing is sent, whatever the demand, until it is `:forward`.
  """
  @type t :: %__MODULE__{
          own: [{atom(), Output.t()}],
          tail: Output.t() | nil,
          left: [Situ.Message.t()],
          demand: :forward | :accumulate
        }

  @doc "Builds the outputs of the vertices of one stage, with the progress recorded in `marks`."
  @spec new([Vertex.t()], Output.marks() | nil) :: t()
  def new([%{module: :operator} | _] = vertices, marks), do: new(List.last(vertices), nil, marks)
  def new([component], marks), do: new(component, nil, marks)
  def new([component | operators], marks), do: new(component, List.last(operators), marks)

  defp new(component, last, marks) do
    own = component |> outputs() |> Enum.sort_by(&elem(&1, 0)) |> Enum.with_index()

    own =
      for {{name, output}, index} <- own, do: {name, Output.attach_marks(output, marks, index)}

    tail =
      with %Vertex{} <- last do
        [{_name, output}] = outputs(last)
        Output.attach_marks(output, marks, length(own))
      end

    %__MODULE__{own: own, tail: tail}
  end

  defp outputs(vertex) do
    for {name, port} <- vertex.outputs,
        do: {name, Output.new(name, vertex.path, port.source_id, vertex.on_same_time)}
  end

  @doc "Returns the output that the component emits on."
  @spec fetch(t(), atom()) :: {:ok, Output.t()} | :error
  def fetch(%__MODULE__{own: own}, name) do
    case List.keyfind(own, name, 0) do
      {_, output} -> {:ok, output}
      nil -> :error
    end
  end

  @spec list_names(t()) :: [atom()]
  def list_names(%__MODULE__{own: own}), do: Enum.map(own, &elem(&1, 0))

  @doc "Replaces an output of the component."
  @spec put(t(), Output.t()) :: t()
  def put(%__MODULE__{own: [{name, _}]} = outputs, %{port: %{name: name}} = output),
    do: %{outputs | own: [{name, output}]}

  def put(%__MODULE__{own: own} = outputs, %{port: %{name: name}} = output),
    do: %{outputs | own: List.keyreplace(own, name, 0, {name, output})}

  @doc "Returns the output that a chain emits on."
  @spec last_output(t()) :: Output.t()
  def last_output(%__MODULE__{tail: nil, own: [{_, output}]}), do: output
  def last_output(%__MODULE__{tail: tail}), do: tail

  @spec put_last(t(), Output.t()) :: t()
  def put_last(%__MODULE__{tail: nil} = outputs, output), do: put(outputs, output)
  def put_last(%__MODULE__{} = outputs, output), do: %{outputs | tail: output}

  @doc "Returns the outputs that others can subscribe to."
  @spec open_outputs(t()) :: [{atom(), Output.t()}]
  def open_outputs(%__MODULE__{tail: nil, own: own}), do: own
  def open_outputs(%__MODULE__{tail: tail}), do: [{tail.port.name, tail}]

  @spec list_all(t()) :: [Output.t()]
  def list_all(%__MODULE__{own: own, tail: nil}), do: Enum.map(own, &elem(&1, 1))
  def list_all(%__MODULE__{own: own, tail: tail}), do: Enum.map(own, &elem(&1, 1)) ++ [tail]

  @spec map_outputs(t(), (Output.t() -> Output.t())) :: t()
  def map_outputs(%__MODULE__{own: [{name, output}], tail: nil} = outputs, fun),
    do: %{outputs | own: [{name, fun.(output)}]}

  def map_outputs(%__MODULE__{own: own, tail: tail} = outputs, fun) do
    own = for {name, output} <- own, do: {name, fun.(output)}
    %{outputs | own: own, tail: tail && fun.(tail)}
  end

  @doc "Updates an output that others can subscribe to."
  @spec update_open(t(), atom(), (Output.t() -> Output.t())) :: t()
  def update_open(%__MODULE__{tail: nil} = outputs, name, fun) do
    {:ok, output} = fetch(outputs, name)
    put(outputs, fun.(output))
  end

  def update_open(%__MODULE__{tail: tail} = outputs, _name, fun),
    do: %{outputs | tail: fun.(tail)}

  @doc "Returns how many messages may be sent now."
  @spec available_room(t()) :: integer() | :infinity
  def available_room(%__MODULE__{demand: :accumulate}), do: 0

  def available_room(%__MODULE__{tail: nil, own: [{_, output}]}),
    do: Output.available_room(output)

  def available_room(%__MODULE__{tail: nil, own: own}), do: room(own, :infinity)
  def available_room(%__MODULE__{left: [], tail: tail}), do: Output.available_room(tail)
  def available_room(%__MODULE__{}), do: 0

  defp room([], room), do: room
  defp room([{_, output} | rest], room), do: room(rest, min(room, Output.available_room(output)))

  @spec flush(t()) :: t()
  def flush(%__MODULE__{tail: nil, own: []} = outputs), do: outputs
  def flush(%__MODULE__{demand: :accumulate} = outputs), do: outputs

  def flush(%__MODULE__{tail: nil, own: [{name, output}]} = outputs) do
    case Output.flush(output) do
      ^output -> outputs
      output -> %{outputs | own: [{name, output}]}
    end
  end

  def flush(%__MODULE__{} = outputs), do: map_outputs(outputs, &Output.flush/1)

  @doc "Sets whether messages are withheld until the pipeline knows the end; `flush/1` sends them after that."
  @spec set_waiting(t(), boolean()) :: t()
  def set_waiting(%__MODULE__{} = outputs, waits?),
    do: map_outputs(outputs, &Output.set_waiting(&1, waits?))

  @spec any_waiting?(t()) :: boolean()
  def any_waiting?(%__MODULE__{} = outputs), do: outputs |> list_all() |> Enum.any?(& &1.waits)

  @doc "Returns whether messages wait for their time."
  @spec any_held?(t()) :: boolean()
  def any_held?(%__MODULE__{} = outputs),
    do: outputs |> list_all() |> Enum.any?(&Output.messages_held?/1)

  @doc "Returns when the first held message is due."
  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{} = outputs) do
    Enum.reduce(list_all(outputs), nil, fn output, first ->
      case Output.next_time(output) do
        nil -> first
        time when first == nil or time < first -> time
        _ -> first
      end
    end)
  end

  @spec release_due(t(), Situ.Time.t()) :: t()
  def release_due(%__MODULE__{} = outputs, now),
    do: map_outputs(outputs, &PostingRules.release_due(&1, now))

  @doc "Adds demand of one subscriber; `:error` if the subscriber is unknown."
  @spec add_demand(t(), {pid(), term()}, pos_integer() | :infinity) :: {:ok, t()} | :error
  def add_demand(%__MODULE__{tail: nil, own: [{name, output}]} = outputs, from, n) do
    with {:ok, output} <- Output.add_demand(output, from, n),
         do: {:ok, %{outputs | own: [{name, output}]}}
  end

  def add_demand(%__MODULE__{} = outputs, from, n) do
    if Enum.any?(list_all(outputs), &Output.has_subscriber?(&1, from)),
      do: {:ok, map_outputs(outputs, &asked(&1, from, n))},
      else: :error
  end

  defp asked(output, from, n) do
    case Output.add_demand(output, from, n) do
      {:ok, output} -> output
      :error -> output
    end
  end

  @doc "Returns whether every subscriber has received all its messages and the closing mark."
  @spec drained?(t()) :: boolean()
  def drained?(%__MODULE__{} = outputs), do: Enum.all?(list_all(outputs), &(&1.subs == []))

  @spec list_subscribers(t()) :: [Subscriber.t()]
  def list_subscribers(%__MODULE__{} = outputs), do: Enum.flat_map(list_all(outputs), & &1.subs)

  @doc "Returns how many messages wait for demand: the maximum among the outputs' subscribers."
  @spec buffered_count(t()) :: non_neg_integer()
  def buffered_count(%__MODULE__{} = outputs),
    do: Enum.reduce(list_all(outputs), 0, &(Output.buffered_count(&1) + &2))

  @doc "Removes subscribers and the messages that wait for them."
  @spec remove_subscribers(t(), (Subscriber.t() -> boolean())) :: t()
  def remove_subscribers(%__MODULE__{} = outputs, which?) do
    for %{monitor: ref} = sub when ref != nil <- list_subscribers(outputs),
        which?.(sub),
        do: Process.demonitor(ref, [:flush])

    map_outputs(outputs, &Output.cancel_subscribers(&1, which?))
  end

  @doc "Ends external consumers with `reason`; internal ones close in their order."
  @spec abandon_external(t(), term()) :: t()
  def abandon_external(%__MODULE__{} = outputs, reason) do
    outputs = flush(set_waiting(outputs, false))

    for %{monitor: ref} = sub when ref != nil <- list_subscribers(outputs),
        do: Subscriber.send_cancel(sub, reason)

    remove_subscribers(outputs, &(&1.monitor != nil))
  end

  @doc "Sends one subscriber all its waiting messages, regardless of demand, and the closing mark."
  @spec cut_subscriber(t(), term(), Situ.Time.t()) :: t()
  def cut_subscriber(%__MODULE__{} = outputs, tag, time) do
    for %{tag: ^tag} = sub <- list_subscribers(outputs),
        do: sub |> Subscriber.add_demand(:infinity) |> Subscriber.send_close(time)

    remove_subscribers(outputs, &(&1.tag == tag))
  end

  @doc "Returns a value that changes when a message is emitted."
  @spec progress_mark(t()) :: term()
  def progress_mark(%__MODULE__{} = outputs),
    do: for(o <- list_all(outputs), do: {o.seq, o.last_time})

  @doc "Returns how many messages had been posted before, or were dropped because of their time."
  @spec repeated_count(t()) :: non_neg_integer()
  def repeated_count(%__MODULE__{} = outputs),
    do: Enum.reduce(list_all(outputs), 0, fn o, n -> n + o.repeated end)
end
