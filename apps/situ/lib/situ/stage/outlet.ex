defmodule Situ.Stage.Outlet do
  @moduledoc false
  # One output of a running component: what is posted (see Posting), what waits for its time, and its subscribers. Only
  # `flush/1`, `ask/3` and `close/2` send.
  alias Situ.Message
  alias Situ.Stage.{Marks, Subscriber}

  defstruct [
    :name,
    :path,
    :source_id,
    :last_time,
    seq: 0,
    last_creation: nil,
    posted: 0,
    pending: [],
    pending_n: 0,
    future: [],
    future_rear: [],
    closing: nil,
    closed: false,
    same_time: :error,
    wanted: nil,
    mark: nil,
    resume: nil,
    repeated: 0,
    subs: []
  ]

  @type t :: %__MODULE__{}

  @doc "The component begins anew: what it posts again, up to the last time, has been posted."
  @spec resume(t()) :: t()
  def resume(%__MODULE__{} = outlet), do: %{outlet | resume: outlet.last_time}

  @doc "The time of the next held message, or `nil`."
  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{future: []}), do: nil
  def next_time(%__MODULE__{future: [first | _]}), do: time_of(first)

  @doc "Throws away held messages later than `final`."
  @spec cut(t(), Situ.Time.t()) :: t()
  def cut(%__MODULE__{future: []} = outlet, _final), do: outlet

  def cut(%__MODULE__{} = outlet, final) do
    kept = Enum.filter(outlet.future ++ Enum.reverse(outlet.future_rear), &(time_of(&1) <= final))
    %{outlet | future: kept, future_rear: []}
  end

  @doc "How many messages may be posted now: the least demand of its subscribers, less what waits in buffers."
  @spec room(t()) :: integer() | :infinity
  def room(%__MODULE__{subs: []}), do: :infinity
  def room(%__MODULE__{closed: true}), do: :infinity
  def room(%__MODULE__{subs: [sub], pending_n: n}), do: less(Subscriber.free(sub), n)

  def room(%__MODULE__{subs: subs, pending_n: n}),
    do: subs |> Enum.map(&Subscriber.free/1) |> Enum.min() |> less(n)

  @doc "Adds a batch already made (chains), oldest last."
  @spec push_reversed(t(), [Message.t()], non_neg_integer()) :: t()
  def push_reversed(%__MODULE__{pending: []} = outlet, reversed, n),
    do: %{outlet | pending: reversed, pending_n: n}

  def push_reversed(%__MODULE__{} = outlet, reversed, n),
    do: %{outlet | pending: reversed ++ outlet.pending, pending_n: outlet.pending_n + n}

  @doc "Hands pending messages to the subscribers, as far as their demand goes; sends closing marks that waited for it."
  @spec flush(t()) :: t()
  def flush(%__MODULE__{pending: [], closing: nil} = outlet), do: outlet
  def flush(%__MODULE__{pending: []} = outlet), do: finish(outlet)
  def flush(%__MODULE__{subs: []} = outlet), do: finish(%{outlet | pending: [], pending_n: 0})

  def flush(%__MODULE__{pending: [last | _], pending_n: n} = outlet) do
    messages = :lists.reverse(outlet.pending)
    Marks.put(outlet.mark, last)
    time = last.originating_time
    ages = {last.creation_time - time, outlet.posted - time}
    subs = Enum.map(outlet.subs, &Subscriber.give(&1, messages, n, ages))
    finish(%{outlet | pending: [], pending_n: 0, subs: subs})
  end

  @doc "More demand from one subscriber."
  @spec ask(t(), term(), pos_integer() | :infinity) :: t()
  def ask(%__MODULE__{} = outlet, tag, n) do
    subs =
      Enum.map(outlet.subs, fn
        %{tag: ^tag} = sub -> Subscriber.ask(sub, n)
        sub -> sub
      end)

    finish(%{outlet | subs: subs})
  end

  @doc "Nothing more will come; the closing mark goes out after everything before it."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{closing: nil} = outlet, time),
    do: flush(cut(%{outlet | closing: time}, time))

  def close(%__MODULE__{} = outlet, _time), do: outlet

  @doc "Adds a subscriber to a running output; a closed one answers with the closing mark."
  @spec subscribe(t(), Subscriber.t()) :: t()
  def subscribe(%__MODULE__{closed: true} = outlet, sub) do
    Subscriber.send_close(sub, outlet.closing)
    outlet
  end

  def subscribe(%__MODULE__{} = outlet, sub), do: %{outlet | subs: outlet.subs ++ [sub]}

  @doc "Takes a subscriber away, with what waited for it."
  @spec cancel(t(), (Subscriber.t() -> boolean())) :: t()
  def cancel(%__MODULE__{} = outlet, which?) do
    finish(%{outlet | subs: Enum.reject(outlet.subs, which?)})
  end

  defp finish(%{closing: nil} = outlet), do: outlet
  defp finish(%{closed: true} = outlet), do: outlet
  defp finish(%{future: [_ | _]} = outlet), do: outlet
  defp finish(%{pending: [_ | _]} = outlet), do: flush(outlet)

  defp finish(%{subs: subs} = outlet) do
    {done, waiting} = Enum.split_with(subs, &(&1.size == 0))
    Enum.each(done, &Subscriber.send_close(&1, outlet.closing))
    %{outlet | subs: waiting, closed: waiting == []}
  end

  defp less(:infinity, _n), do: :infinity
  defp less(room, n), do: room - n

  @doc "The originating time of a held item."
  @spec time_of({Situ.Time.t(), term()} | Message.t()) :: Situ.Time.t()
  def time_of({time, _data}), do: time
  def time_of(%Message{originating_time: time}), do: time
end
