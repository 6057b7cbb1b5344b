[line_length: 98, inputs: ["{mix,.formatter}.exs", "{lib,test,examples}/**/*.{ex,exs}"]]
