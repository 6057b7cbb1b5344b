defmodule Situ.EditLog.Mark do
  @moduledoc false
  # The member `edits` of a document's file: the log and the version that the file contains, and a digest of its text,
  # which shows that somebody has edited the file.

  @form ~r/"edits": \{"log": "[0-9a-f]{16}", "version": \d+, "offset": \d+, "digest": "([0-9a-f]{64})"\}/
  @zeros String.duplicate("0", 64)

  @doc "Encodes the member's value with an empty digest; `nil` without a log."
  @spec encode({String.t(), non_neg_integer(), non_neg_integer()} | nil) :: String.t() | nil
  def encode(nil), do: nil

  def encode({id, version, offset}),
    do: ~s({"log": "#{id}", "version": #{version}, "offset": #{offset}, "digest": "#{@zeros}"})

  @doc "Returns the fields of the member for the file from which a log began."
  @spec first(Situ.EditLog.t()) :: map()
  def first(log),
    do: %{"log" => log.id, "version" => 0, "offset" => log.offset, "intact" => true}

  @doc """
  Returns the digest of a text (SHA-256, hexadecimal), in which the digits of the member's own digest are zeros.
  """
  @spec text_digest(binary()) :: String.t()
  def text_digest(text),
    do: :sha256 |> :crypto.hash(clear_digest(text)) |> Base.encode16(case: :lower)

  defp clear_digest(text) do
    case Regex.run(@form, text, return: :index) do
      [_, {at, length}] ->
        <<head::binary-size(at), _::binary-size(length), tail::binary>> = text
        [head, @zeros, tail]

      nil ->
        text
    end
  end

  @doc "Inserts the digest into a text with an empty one."
  @spec put_digest(binary()) :: binary()
  def put_digest(text) do
    case Regex.run(@form, text, return: :index) do
      [_, {at, length}] ->
        <<head::binary-size(at), _::binary-size(length), tail::binary>> = text
        head <> text_digest(text) <> tail

      nil ->
        text
    end
  end

  @doc "Returns the fields of the member if they are complete."
  @spec parse(term()) :: map() | nil
  def parse(%{"log" => log, "version" => version, "offset" => offset} = mark)
      when is_binary(log) and is_integer(version) and version >= 0 and is_integer(offset) and
             offset >= 0,
      do: mark

  def parse(_), do: nil
end
