defmodule Situ.Infer.VoiceGateTest do
  use ExUnit.Case, async: true
  import Situ.Test.Property, only: [property: 2]
  alias Situ.Infer.VoiceGate
  doctest Situ.Infer.VoiceGate

  property "a gate decides every span once, in order and within its limit" do
    {
      {:proper_types.list(:proper_types.float(0.0, 1.0)), :proper_types.range(0, 60),
       :proper_types.range(0, 60)},
      fn {ps, min_speech, min_silence} ->
        gate = VoiceGate.new(min_speech: min_speech, min_silence: min_silence)

        {events, gate} =
          ps
          |> Enum.with_index(1)
          |> Enum.flat_map_reduce(gate, fn {p, i}, gate ->
            {out, gate} = VoiceGate.push(gate, i * 10, 10, p)
            {Enum.map(out, &{i * 10, &1}), gate}
          end)

        {last, _} = VoiceGate.close(gate)
        now = length(ps) * 10
        all = events ++ Enum.map(last, &{now, &1})
        times = for {_, {t, v}} <- all, is_boolean(v), do: t
        late = for {at, {t, v}} <- all, is_boolean(v), do: at - t

        # Unsure speech may last as long as the first value, and the pause in it as long as the second.
        times == Enum.map(1..length(ps)//1, &(&1 * 10)) and
          Enum.all?(
            late,
            &(&1 <= min_speech + min_silence + 20)
          )
      end
    }
  end
end
