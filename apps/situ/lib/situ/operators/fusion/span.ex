defmodule Situ.Fusion.Span do
  @moduledoc false
  # From which originating time on an input takes part, or is left out: what may still be decided, and what is over.
  alias Situ.{Error, Message}

  # Before every time that there is.
  @beginning -0x8000000000000000

  @spec beginning() :: Situ.Time.t()
  def beginning, do: @beginning

  @doc "The first time behind all of these; `nil` when there are none."
  @spec behind([Situ.Time.t() | nil]) :: Situ.Time.t() | nil
  def behind(times) do
    case Enum.reject(times, &is_nil/1) do
      [] -> nil
      times -> Enum.max(times) + 1
    end
  end

  @doc "The time that was asked for, or else the earliest; one before the earliest is too late."
  @spec possible(Situ.Time.t() | nil, Situ.Time.t() | nil, String.t()) ::
          {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def possible(nil, earliest, _what), do: {:ok, earliest}
  def possible(time, nil, _what), do: {:ok, time}
  def possible(time, earliest, _what) when time >= earliest, do: {:ok, time}

  def possible(time, earliest, what) do
    {:error,
     Error.new(:too_late, "an input cannot #{what} #{time} ns",
       why: "messages up to #{earliest - 1} ns have already been handled",
       fix: "give a time of #{earliest} ns or later, or none",
       meta: %{earliest: earliest}
     )}
  end

  @doc """
  Whether no primary will need a span any more: it never began, or those before its end have been handled and none can
  come.
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
