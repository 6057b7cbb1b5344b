defmodule Situ.Live.Stream do
  @moduledoc false
  # A list that only the browser keeps: the server sends inserts and deletes and then discards
  # them.
  #
  #     # mount:   stream(socket, :lines, lines)
  #     # event:   stream_insert(socket, :lines, line, at: 0, limit: 200)
  #     <ul id="lines" phx-update="stream">
  #       <li :for={{id, line} <- @streams.lines} id={id}>{line.text}</li>
  #     </ul>
  #
  # Each item needs an `:id`, or the option `dom_id:` with a function that returns the row's id.
  alias __MODULE__, as: S

  @enforce_keys [:name, :ref, :dom_id]
  defstruct [:name, :ref, :dom_id, inserts: [], deletes: [], reset?: false]

  @type t :: %S{}

  @doc false
  @spec new(atom(), Enumerable.t(), keyword()) :: t()
  def new(name, items, opts) do
    dom_id = opts[:dom_id] || fn item -> "#{name}-#{item.id}" end
    stream = %S{name: name, ref: Integer.to_string(:erlang.phash2(name)), dom_id: dom_id}
    Enum.reduce(items, %{stream | reset?: opts[:reset] == true}, &insert(&2, &1, opts))
  end

  @doc false
  @spec insert(t(), term(), keyword()) :: t()
  def insert(%S{} = stream, item, opts) do
    row = {stream.dom_id.(item), item, opts[:at] || -1, opts[:limit], opts[:update_only]}
    %{stream | inserts: [row | List.keydelete(stream.inserts, elem(row, 0), 0)]}
  end

  @doc false
  @spec delete(t(), String.t()) :: t()
  def delete(%S{} = stream, dom_id) do
    inserts = List.keydelete(stream.inserts, dom_id, 0)
    %{stream | inserts: inserts, deletes: [dom_id | stream.deletes]}
  end

  @doc false
  @spec clear(t()) :: t()
  def clear(%S{} = stream), do: %{stream | inserts: [], deletes: [], reset?: false}

  @doc false
  @spec inserted_items(t()) :: [{String.t(), term()}]
  def inserted_items(%S{inserts: inserts}),
    do: for({id, item, _, _, _} <- Enum.reverse(inserts), do: {id, item})

  @doc false
  @spec to_wire(t()) :: list()
  def to_wire(%S{} = stream) do
    inserts =
      for {id, _, at, limit, only} <- Enum.reverse(stream.inserts),
          do: [id, at, limit, only == true]

    message = [stream.ref, inserts, Enum.reverse(stream.deletes)]
    if stream.reset?, do: message ++ [true], else: message
  end

  defimpl Enumerable do
    def reduce(stream, acc, fun), do: Enumerable.List.reduce(S.inserted_items(stream), acc, fun)
    def count(stream), do: {:ok, length(stream.inserts)}
    def member?(_, _), do: {:error, __MODULE__}
    def slice(_), do: {:error, __MODULE__}
  end
end
