defmodule Situ.Remote.Connection.Positions do
  @moduledoc false
  # How far each stream of a link has come, and which part of that its file knows. `saved`: in the file; `confirmed`:
  # what the pipeline has confirmed (nil before the first time), which outranks what it has merely taken; `left`: of
  # streams that nobody subscribes any more.
  alias Situ.Error
  alias Situ.Remote.Position

  defstruct saved: %{}, confirmed: %{}, left: %{}

  @type t :: %__MODULE__{
          saved: Position.t(),
          confirmed: %{String.t() => Situ.Time.t() | nil},
          left: Position.t()
        }

  @doc "From now on the position of the stream is what is confirmed of it."
  @spec confirming(t(), String.t()) :: t()
  def confirming(%__MODULE__{} = positions, name),
    do: %{positions | confirmed: Map.put_new(positions.confirmed, name, nil)}

  @spec confirm(t(), String.t(), Situ.Time.t()) :: t()
  def confirm(%__MODULE__{} = positions, name, time),
    do: %{positions | confirmed: Map.put(positions.confirmed, name, time)}

  @doc "Nobody subscribes the stream any more, of which everything up to `time` was taken."
  @spec leave(t(), String.t(), Situ.Time.t() | nil) :: t()
  def leave(%__MODULE__{} = positions, _name, nil), do: positions

  def leave(%__MODULE__{} = positions, name, time),
    do: %{positions | left: Map.put(positions.left, name, time)}

  @doc "Writes them to the file, with those `taken` of streams that are subscribed, when they have changed."
  @spec save(t(), Path.t(), [{String.t(), Situ.Time.t() | nil}]) ::
          {:ok | {:error, Error.t()}, t()}
  def save(%__MODULE__{} = positions, path, taken) do
    known = positions.left |> Map.merge(known(taken)) |> Map.merge(positions.confirmed)
    now = Map.merge(positions.saved, known(known))

    if now == positions.saved,
      do: {:ok, positions},
      else: {Position.save(path, now), %{positions | saved: now}}
  end

  defp known(times), do: for({name, time} <- times, time != nil, into: %{}, do: {name, time})
end
