defmodule Situ.Studio.Sensor.Inbox do
  @moduledoc false
  # Holds the state of a source whose sensor is a page: its name, the connected page, and the data from the page that
  # waits for the pipeline. One output is credited: the page sends more of it only after the pipeline has taken some.
  alias Situ.Error

  @enforce_keys [:kind, :name, :credited, :ahead, :buffer]
  # `ending` is nil, :page_left once the outputs shall end, or :complete.
  defstruct @enforce_keys ++
              [page: nil, waiting: %{}, dropped: 0, last: %{}, end_with_page: false, ending: nil]

  @type t :: %__MODULE__{}
  @registry Situ.Studio.Registry
  # How long a sensor that ends with its page waits for the page.
  @page_timeout_ms 300_000

  @doc "Builds an inbox. `kind` is the component's module; names are unique within a kind."
  @spec new(module(), String.t(), keyword()) :: t()
  def new(kind, name, opts), do: struct!(__MODULE__, [kind: kind, name: name] ++ opts)

  @spec register_sensor(t()) :: {[Situ.Component.action()], t()}
  def register_sensor(%__MODULE__{} = inbox) do
    case Registry.register(@registry, {:sensor, inbox.kind, inbox.name}, nil) do
      {:ok, _} when inbox.end_with_page ->
        Process.send_after(self(), :page_timeout, @page_timeout_ms)
        {[], inbox}

      {:ok, _} ->
        {[{:complete, :infinity}], inbox}

      {:error, _} ->
        raise Error.new(
                :sensor_taken,
                "a sensor called #{inspect(inbox.name)} is already running",
                fix: "choose a different page:"
              )
    end
  end

  @doc "Fetches the process of the sensor with this name."
  @spec fetch_sensor(module(), String.t()) :: {:ok, pid()} | :error
  def fetch_sensor(kind, name) do
    case Registry.lookup(@registry, {:sensor, kind, name}) do
      [{pid, _}] -> {:ok, pid}
      [] -> :error
    end
  end

  @doc "Registers the caller as the page of this sensor. Returns `:error` if another page is registered."
  @spec register_page(module(), String.t(), pid()) :: :ok | :error
  def register_page(kind, name, sensor) do
    with {:ok, _} <- Registry.register(@registry, {:sensor_page, kind, name}, nil) do
      send(sensor, {:sensor_page, self()})
      :ok
    else
      {:error, _} -> :error
    end
  end

  @doc "Fetches the connection of the page that is this sensor."
  @spec fetch_page(module(), String.t()) :: {:ok, pid()} | :error
  def fetch_page(kind, name) do
    case Registry.lookup(@registry, {:sensor_page, kind, name}) do
      [{pid, _}] -> {:ok, pid}
      [] -> :error
    end
  end

  @spec handle_message(t(), term()) :: t()
  def handle_message(%__MODULE__{} = inbox, {:sensor_page, pid}) do
    Process.monitor(pid)
    send(pid, {:credit, inbox.ahead})
    %{inbox | page: pid}
  end

  def handle_message(%__MODULE__{page: pid} = inbox, {:DOWN, _, :process, pid, _}),
    do: start_ending(%{inbox | page: nil})

  def handle_message(%__MODULE__{page: nil} = inbox, :page_timeout), do: start_ending(inbox)

  def handle_message(%__MODULE__{} = inbox, {:sensor, output, time, data}),
    do: push_message(inbox, output, time, data)

  def handle_message(%__MODULE__{} = inbox, _other), do: inbox

  defp start_ending(%{end_with_page: true, ending: nil} = inbox),
    do: %{inbox | ending: :page_left}

  defp start_ending(inbox), do: inbox

  @doc "Completes the outputs when the page has left and the pipeline has taken all its data."
  @spec complete_outputs(t()) :: {[Situ.Component.action()], t()}
  def complete_outputs(%__MODULE__{ending: :page_left} = inbox) do
    if Enum.all?(inbox.waiting, fn {_output, queue} -> :queue.is_empty(queue) end) do
      last = inbox.last |> Map.values() |> Enum.max(fn -> Situ.Time.now() end)
      {[{:complete, last}], %{inbox | ending: :complete}}
    else
      {[], inbox}
    end
  end

  def complete_outputs(%__MODULE__{} = inbox), do: {[], inbox}

  # Times are converted between two clocks, and may step back a little.
  defp push_message(inbox, output, time, data) do
    case inbox.last do
      %{^output => last} when time <= last ->
        send_credit(output, %{inbox | dropped: inbox.dropped + 1})

      last ->
        queue = :queue.in({time, data}, Map.get(inbox.waiting, output, :queue.new()))

        limit_queue(
          put_in(%{inbox | last: Map.put(last, output, time)}.waiting[output], queue),
          output
        )
    end
  end

  # The page's credit already limits this queue.
  defp limit_queue(%{credited: output} = inbox, output), do: inbox

  defp limit_queue(inbox, output) do
    if :queue.len(inbox.waiting[output]) > inbox.buffer do
      inbox = update_in(inbox.waiting[output], &:queue.drop/1)
      %{inbox | dropped: inbox.dropped + 1}
    else
      inbox
    end
  end

  @doc "Takes at most `n` of the waiting values, earliest first."
  @spec take_actions(t(), non_neg_integer()) :: {[Situ.Component.action()], t()}
  def take_actions(%__MODULE__{} = inbox, n), do: take_actions(inbox, n, [])

  defp take_actions(inbox, 0, actions), do: {Enum.reverse(actions), inbox}

  defp take_actions(inbox, n, actions) do
    heads =
      for {output, queue} <- inbox.waiting,
          {:value, {time, _}} <- [:queue.peek(queue)],
          do: {time, output}

    case Enum.min(heads, fn -> nil end) do
      nil ->
        {Enum.reverse(actions), inbox}

      {time, output} ->
        {{:value, {^time, data}}, queue} = :queue.out(inbox.waiting[output])
        inbox = send_credit(output, put_in(inbox.waiting[output], queue))
        take_actions(inbox, n - 1, [{output, time, data} | actions])
    end
  end

  defp send_credit(output, %{credited: output, page: pid} = inbox) when is_pid(pid) do
    send(pid, {:credit, 1})
    inbox
  end

  defp send_credit(_output, inbox), do: inbox

  @doc "Notifies the page that the pipeline has ended."
  @spec notify_ended(t()) :: :ok
  def notify_ended(%__MODULE__{page: nil}), do: :ok

  def notify_ended(%__MODULE__{page: pid}) do
    send(pid, :sensor_ended)
    :ok
  end

  @spec describe(t()) :: String.t()
  def describe(inbox),
    do: "#{if inbox.page, do: "page connected", else: "no page"}, #{inbox.dropped} dropped"
end
