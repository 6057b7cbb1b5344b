defmodule Situ.Fusion.Span do
  @moduledoc false
  # The span of originating times for which an input takes part. Checks new bounds, and whether the span is over.
  alias Situ.{Error, Message}

  # Earlier than every possible time.
  @beginning -0x8000000000000000

  @spec beginning() :: Situ.Time.t()
  def beginning, do: @beginning

  @doc "Returns the first time after all of these times, or `nil` if there are none."
  @spec behind([Situ.Time.t() | nil]) :: Situ.Time.t() | nil
  def behind(times) do
    case Enum.reject(times, &is_nil/1) do
      [] -> nil
      times -> Enum.max(times) + 1
    end
  end

  @doc "Returns the requested time, or the earliest one if none was requested. Rejects times before the earliest."
  @spec possible(Situ.Time.t() | nil, Situ.Time.t() | nil, String.t()) ::
          {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def possible(nil, earliest, _what), do: {:ok, earliest}
  def possible(time, nil, _what), do: {:ok, time}
  def possible(time, earliest, _what) when time >= earliest, do: {:ok, time}

  def possible(time, earliest, what) do
    {:error,
     Error.new(:too_late, "an input cannot #{what} #{time} ns",
       why: "messages up to #{earliest - 1} ns have already been handled",
       fix: "use a time of #{earliest} ns or later, or omit it",
       meta: %{earliest: earliest}
     )}
  end

  @doc """
  Returns whether no later primary can need the span: it never began, or all primaries before its end have been
  handled and no more can arrive.
  """
  @spec over?(
          {Situ.Time.t() | nil, Situ.Time.t() | nil},
          Situ.Time.t() | nil,
          boolean(),
          {[Message.t()], [[Message.t()]]}
        ) :: boolean()
  def over?({_from, nil}, _arrived, _closed, _waiting), do: false
  def over?({_from, @beginning}, _arrived, _closed, _waiting), do: true

  def over?({from, until}, _arrived, _closed, _waiting) when from != nil and until <= from,
    do: true

  def over?({_from, until}, arrived, closed, {front, rear}) do
    (closed or (arrived != nil and arrived >= until - 1)) and not waits?(front, rear, until)
  end

  defp waits?([%{originating_time: time} | _], _rear, until), do: time < until
  defp waits?([], [], _until), do: false
  defp waits?([], rear, until), do: waits?(List.last(rear), [], until)
end
