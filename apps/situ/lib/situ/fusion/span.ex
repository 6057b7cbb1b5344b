defmodule Situ.Fusion.Span do
  @moduledoc false
  # The span of originating times for which an input takes part. Checks new bounds, and whether the span is over.
  alias Situ.{Error, Message}

  # Earlier than every possible time.
  @beginning -0x8000000000000000

  @spec before_all_times() :: Situ.Time.t()
  def before_all_times, do: @beginning

  @doc "Returns the first time after all of these times, or `nil` if there are none."
  @spec first_time_after([Situ.Time.t() | nil]) :: Situ.Time.t() | nil
  def first_time_after(times) do
    case Enum.reject(times, &is_nil/1) do
      [] -> nil
      times -> Enum.max(times) + 1
    end
  end

  @doc "Returns the requested time, or the earliest one if none was requested. Rejects times before the earliest."
  @spec validate_time(Situ.Time.t() | nil, Situ.Time.t() | nil, String.t()) ::
          {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def validate_time(nil, earliest, _what), do: {:ok, earliest}
  def validate_time(time, nil, _what), do: {:ok, time}
  def validate_time(time, earliest, _what) when time >= earliest, do: {:ok, time}

  def validate_time(time, earliest, what) do
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
  @spec no_longer_needed?(
          {Situ.Time.t() | nil, Situ.Time.t() | nil},
          Situ.Time.t() | nil,
          boolean(),
          {[Message.t()], [[Message.t()]]}
        ) :: boolean()
  def no_longer_needed?({_from, nil}, _arrived, _closed, _waiting), do: false
  def no_longer_needed?({_from, @beginning}, _arrived, _closed, _waiting), do: true

  def no_longer_needed?({from, until}, _arrived, _closed, _waiting)
      when from != nil and until <= from,
      do: true

  def no_longer_needed?({_from, until}, arrived, closed, {front, rear}) do
    (closed or (arrived != nil and arrived >= until - 1)) and
      not waiting_before?(front, rear, until)
  end

  defp waiting_before?([%{originating_time: time} | _], _rear, until), do: time < until
  defp waiting_before?([], [], _until), do: false
  defp waiting_before?([], rear, until), do: waiting_before?(List.last(rear), [], until)
end
