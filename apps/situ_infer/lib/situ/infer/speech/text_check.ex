defmodule Situ.Infer.Speech.TextCheck do
  @moduledoc false
  # Checks the texts that synthesizers speak.
  alias Situ.Error

  @doc "Checks that a text can be spoken; returns `:nothing` if it contains nothing to speak."
  @spec check_text(String.t(), pos_integer()) :: :ok | :nothing | {:error, Error.t()}
  def check_text(text, most_bytes) do
    cond do
      not String.valid?(text) or String.contains?(text, <<0>>) -> bad_text("it is not valid text")
      byte_size(text) > most_bytes -> bad_text("it has more than #{most_bytes} bytes")
      speakable?(text) -> :ok
      true -> :nothing
    end
  end

  defp bad_text(why) do
    fix = "split it into sentences"
    {:error, Error.new(:bad_text, "the text cannot be spoken", why: why, fix: fix)}
  end

  @doc "Returns whether a text contains letters, numbers or symbols."
  @spec speakable?(String.t()) :: boolean()
  def speakable?(text), do: text =~ ~r/[\p{L}\p{N}\p{S}]/u
end
