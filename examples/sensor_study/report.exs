# Writes strides.csv and prints it: `mix run report.exs`, after `situ task run study.json`.
{:ok, dataset} = Situ.Dataset.open("study.json")
SensorStudy.report(dataset, "strides.csv")
agreement = SensorStudy.agreement(dataset, "lower", "upper")
shift = Situ.Time.format_duration(round(agreement.begin_error))
IO.puts("#{agreement.paired} swings are in both sessions; their beginnings differ by #{shift} on average.")
