defmodule Situ.Infer.SampleCheck do
  @moduledoc false
  # Checks audio for networks: it must have complete frames of finite samples. A single NaN would turn a recurrent
  # network's whole state into NaN permanently.
  alias Situ.{AudioBuffer, Error}

  @spec check_buffer(AudioBuffer.t()) :: :ok | {:error, Error.t()}
  def check_buffer(%AudioBuffer{} = buffer) do
    case AudioBuffer.validate(buffer) do
      {:ok, %{format: %{sample: :f32}, data: data}} -> check_f32(data, 0)
      {:ok, %{format: %{sample: :f64}, data: data}} -> check_f64(data, 0)
      {:ok, _} -> :ok
      {:error, error} -> {:error, %{error | fix: error.fix || "check the source of the audio"}}
    end
  end

  defp check_f32(<<_::float-native-32, rest::binary>>, i), do: check_f32(rest, i + 1)
  defp check_f32(<<>>, _i), do: :ok
  defp check_f32(_, i), do: bad_sample(i)

  defp check_f64(<<_::float-native-64, rest::binary>>, i), do: check_f64(rest, i + 1)
  defp check_f64(<<>>, _i), do: :ok
  defp check_f64(_, i), do: bad_sample(i)

  defp bad_sample(i) do
    {:error,
     Error.new(:bad_audio, "invalid audio: sample #{i} is not a number (NaN or infinite)",
       why: "an earlier component divided by zero or overflowed",
       fix: "check the source of the audio; Situ.map can replace such buffers with silence"
     )}
  end
end
